"""What is stated of a posterior: every threshold of a decision, and the decision."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final, Literal

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.forms.terms import MemoryClass, Region
from rlgcomp.diagnosis.search.states import State
from rlgcomp.physics.mechanism import TABLE_RATE

Verdict = Literal["none", "explained", "ambiguous", "unknown"]
VERDICTS: Final = ("none", "explained", "ambiguous", "unknown")

FALSE_FINDING: Final = 1.0
MISSED: Final = 1.0
"""Losses of naming a set where nothing is missing, and of naming nothing where it is: none is named while P(null) × the first
exceeds the probability of the likeliest set × the second."""
EXCHANGED: Final = 0.1
"""Probability, over that of the likeliest set, of a set with one member exchanged or left out, from which on the two cannot be
told apart."""
SURE: Final = 0.9
"""Probability from which on a member is named without its exchanges: of those below one in ten or more is another."""
LOUDER: Final = 1e-3
"""Probability of noise as large as it is under what is stated, below which that does not explain the runs."""
TELEGRAPH: Final = "random_telegraph"


@dataclasses.dataclass(frozen=True)
class Named:
    """A region that is named.

    Parameters
    ----------
    region : str
    mechanism : str, optional
        None: a law without a name.
    probability : float
    indistinguishable_from : tuple of str
        Mechanisms or laws that may stand in its place.
    perhaps_nothing : float
        Probability of the set without it, where that is nearly as likely as the set; else zero.
    """

    region: str
    mechanism: str | None
    probability: float
    indistinguishable_from: tuple[str, ...]
    perhaps_nothing: float = 0.0


@dataclasses.dataclass(frozen=True)
class Decision:
    """The verdict, what is named, and what is unexplained.

    Parameters
    ----------
    verdict : {"none", "explained", "ambiguous", "unknown"}
    named : tuple of Named
    drivers : tuple of str
        Of laws without a name.
    memory : {"static", "dynamic", "rate-independent", "none"}
        Of the first of them.
    wander : bool
        Something unrecorded wanders.
    louder : bool
        The runs are noisier than stated.
    unstated : tuple of str
        Regions of the set that are taken for a part of the form of what is named.
    """

    verdict: Verdict
    named: tuple[Named, ...]
    drivers: tuple[str, ...] = ()
    memory: MemoryClass = "none"
    wander: bool = False
    louder: bool = False
    unstated: tuple[str, ...] = ()


def decided(posterior: Posterior) -> Decision:
    """The decision of least loss."""
    best = posterior.best
    regions, latent = posterior.effects(best.key), best.key[1]
    own = posterior.of_effects[posterior.effects_of(best)]
    if (not regions and not latent) or posterior.null * FALSE_FINDING > own * MISSED:
        return Decision("none", ())
    named, unstated = [], []
    for key in sorted(sorted(regions), key=posterior.of_region, reverse=True):
        probability = posterior.of_region(key)
        partners = {other: p for other, p in posterior.instead_of(key).items() if p > EXCHANGED * own}
        partners = partners if probability < SURE else {}
        region = posterior.regions[key]
        owned = _owned(region, [posterior.regions[other] for other in regions])
        if owned or _form_of_an_equation(region, best, posterior.regions):
            unstated.append(key)
            continue
        alike = tuple(sorted(partners, key=lambda other: partners[other], reverse=True))
        without = _dispensable(probability, posterior.without(key) if len(regions) > 1 else 0.0, own)
        named.append(Named(key, region.mechanism, min(probability, 1.0), alike, without))
    unrecorded = posterior.of_latent(latent)
    calm = posterior.of_effects.get((regions, ""), 0.0) if latent and regions else 0.0  # nothing unrecorded beside the set
    perhaps_calm = _dispensable(unrecorded, calm, own)
    if latent == "telegraph":
        named.append(Named(TELEGRAPH, TELEGRAPH, min(unrecorded, 1.0), (), perhaps_calm))
    laws = [posterior.regions[one.region] for one in named if one.mechanism is None]
    wanders = latent == "wander"
    drivers = tuple(dict.fromkeys(column for law in laws for column in law.drivers))
    memory = laws[0].memory if laws else "none"
    verdict = _verdict(named, wanders, perhaps_calm > 0.0)
    return Decision(verdict, tuple(named), drivers, memory, wanders, unstated=tuple(unstated))


def _verdict(named: Sequence[Named], wanders: bool, perhaps_calm: bool) -> Verdict:
    """Of what is named, beside something unrecorded that wanders, or perhaps does not.

    What has no name makes physics unknown, unless it may be nothing beside a mechanism.
    """
    mechanisms = any(one.mechanism is not None for one in named)
    surely = [one for one in named if one.mechanism is None and not (mechanisms and one.perhaps_nothing)]
    if surely or (wanders and not (mechanisms and perhaps_calm)):
        return "unknown"
    return "ambiguous" if wanders or any(one.indistinguishable_from or one.perhaps_nothing for one in named) else "explained"


def _dispensable(probability: float, without: float, own: float) -> float:
    """Probability of a set without something of it, where that is nearly as likely as the set; else zero."""
    return min(without, 1.0) if probability < SURE and without > EXCHANGED * own else 0.0


def _owned(law: Region, regions: Sequence[Region]) -> bool:
    """Whether a law lies within the region of a named mechanism of the set, columns and memory: a richer form of that."""
    owners = (set(region.drivers) for region in regions if region.mechanism is not None and region.memory == law.memory)
    return law.mechanism is None and any(set(law.drivers) <= drivers for drivers in owners)


def _form_of_an_equation(region: Region, state: State, regions: Mapping[str, Region]) -> bool:
    """Whether a member may be what the equation of a named one of its columns and memory is wrong by: none of its forms departs.

    Where some do, the model has weighed them. The equation has shapes, or the member follows more than the table's rate: what
    follows the rate alone beside one without shapes, such as a misalignment, is no form of it, which is geometry and exact.
    """
    size = next(member.size for member in state.members if member.form.region == region.key)
    for member in state.members:
        one, shaped = regions[member.form.region], any(basis.parameters() for basis in member.form.lead)
        alike = region.drivers and set(region.drivers) <= set(one.drivers) and region.memory == one.memory
        exact = not (member.form.departures or any(form.departures for form in one.forms))
        small = exact and size <= priors.DISCREPANCY * member.size
        if one.mechanism is not None and alike and small and (shaped or set(region.drivers) != {TABLE_RATE}):
            return True
    return False
