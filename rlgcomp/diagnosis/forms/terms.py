"""Terms of the model: forms in regions. A mechanism is the name of a region of driver × memory × form."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.hashed import Hashed

Array = npt.NDArray[np.float64]

WANDER: Final = "wander"
"""Key of the region of something unrecorded that wanders smoothly; what wanders roughly is a hypothesis of the noise."""
MemoryClass = Literal["static", "dynamic", "rate-independent", "none"]


@dataclasses.dataclass(frozen=True)
class Form(Hashed):
    """One family of functions, s (B₀ w₀ + δ B₁ w₁) with Gaussian weights.

    Parameters
    ----------
    region : str
        Key of the region that it lies in.
    equation : str
        In words of the drivers, for people.
    lead : tuple of Basis
        B₀; each has weights of its own.
    smooth : tuple of Basis
        Part of B₁: smooth functions of the same driver and memory.
    own : tuple of type of Basis
        The rest of B₁: what is made of each leading basis, as its shift in time.
    log_share : float
        Of the region's prior.
    unit : float
        Strength of a term of size one.
    sizes : tuple of float
        Logarithm of the prior of each size over that of the usual ones, which are equally likely; empty, it is zero.
    positive : bool
        The last weight is positive.
    """

    region: str
    equation: str
    lead: tuple[Basis, ...]
    smooth: tuple[Basis, ...] = ()
    own: tuple[Callable[[Basis], Basis], ...] = ()
    log_share: float = 0.0
    unit: float = 1.0
    sizes: tuple[float, ...] = ()
    positive: bool = False

    @functools.cached_property
    def bases(self) -> tuple[Basis, ...]:
        """All of them."""
        return *self.lead, *self.departures

    @functools.cached_property
    def departures(self) -> tuple[Basis, ...]:
        """B₁."""
        return (*self.smooth, *(make(basis) for make in self.own for basis in self.lead))

    def nearby(self, step: float) -> tuple[Self, ...]:
        """The same with one nonlinear parameter of a leading basis moved by so many steps of its grid."""
        return tuple(self.moved(k, basis) for k, own in enumerate(self.lead) for basis in own.nearby(step))

    def without(self, departure: Callable[[Basis], Basis]) -> Self:
        """The same without one kind of what is made of each leading basis."""
        own = tuple(make for make in self.own if make is not departure)
        return self if own == self.own else dataclasses.replace(self, own=own)

    def moved(self, k: int, basis: Basis) -> Self:
        """The same with another leading basis at a place."""
        return dataclasses.replace(self, lead=(*self.lead[:k], basis, *self.lead[k + 1 :]))


@dataclasses.dataclass(frozen=True, eq=False)
class Left:
    """What a member of a set leaves.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        Its products with window means are those of whitened columns with what is left.
    variance : float
        Of the white noise of a window without gaps.
    weights : tuple of ndarray
        Of each leading basis of the member, roughly.
    """

    residual: Array
    variance: float
    weights: tuple[Array, ...]


Others = Callable[[Form], Iterable[Form]]  # forms that one may become
Joined = Callable[[Form, Form], Form | None]  # one form in place of two, where there is one


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """A class of driver × memory with the forms that are tried in it.

    Parameters
    ----------
    key : str
        The name of the mechanism, or what the law is one of.
    mechanism : str, optional
        None: a law without a name.
    log_odds : float
        That a term of it is missing.
    forms : tuple of Form
    drivers : tuple of str
        Recorded columns.
    memory : str
    grow : callable, optional
        Richer forms of the same region about a form that was found.
    shrink : callable, optional
        Such a richer form with one of its further leading bases less, each in turn.
    absorb : callable, optional
        A form of this region with the leading bases of another region's form as well; None where these are of another cause.
    adopt : callable, optional
        One of the region's forms of one leading basis with those of another region's form in its place; None as above.
    rougher : callable, optional
        A form with departures that are too many to be screened; None where it has none.
    renew : callable, optional
        Forms about what is left and the weights of its leading bases show, in place of one that is about something else; of several
        kinds, each of which is followed to its own end.
    one_history : callable, optional
        A form at its prior, and forms that explain alike what was before the runs: tried in the set that predicts alone.
    propose : callable, optional
        Forms that a residual suggests, where there are too many to try all; it is whitened window means of all runs.
    nuisance : bool
        No missing physics: a step of the bias, a bias a run, a stated number that is wrong.
    finer : tuple of Form
        Further forms that are tried in the likeliest set alone, and in its rivals where it is clearly likelier at its finest.
    """

    key: str
    mechanism: str | None
    log_odds: float
    forms: tuple[Form, ...]
    drivers: tuple[str, ...] = ()
    memory: MemoryClass = "static"
    grow: Others | None = None
    shrink: Others | None = None
    absorb: Joined | None = None
    adopt: Joined | None = None
    rougher: Callable[[Form], Form | None] | None = None
    renew: Callable[[Form, Left], Iterable[tuple[Form, ...]]] | None = None
    one_history: Others | None = None
    propose: Callable[[Array], tuple[Form, ...]] | None = None
    nuisance: bool = False
    finer: tuple[Form, ...] = ()

    @property
    def renews_listed(self) -> bool:
        """Whether forms that are listed are renewed; lines are renewed where they are proposed."""
        return self.renew is not None and self.propose is None


@dataclasses.dataclass(frozen=True)
class Family:
    """Forms of a kind within a region, which share its prior equally.

    Parameters
    ----------
    equation : str
    leads : sequence of tuple of Basis
        One a form.
    smooth, own :
        As of :class:`Form`.
    weight : float
        Of this family against the others of its region.
    """

    equation: str
    leads: Sequence[tuple[Basis, ...]]
    smooth: tuple[Basis, ...] = ()
    weight: float = 1.0
    own: tuple[Callable[[Basis], Basis], ...] = ()


def weighted(families: Iterable[Family], weight: float) -> list[Family]:
    """Families of so many times their weight."""
    return [dataclasses.replace(family, weight=weight * family.weight) for family in families]


def log_odds_of_more(members: int, more: int, places: int) -> float:
    r"""Log odds of a form with further members, each at one of some places: :math:`q^m (n + m)! / (n! N^m)`, m more beside n.

    Members have no order: those of one form may have been chosen one after the other in as many ways as there are orders.

    Parameters
    ----------
    members : int
        That the form has, of this kind; n.
    more : int
        Further ones; m. Negative: so many less.
    places : int
        N.
    """
    return more * math.log(priors.MORE_STEPS / places) + math.lgamma(members + more + 1) - math.lgamma(members + 1)


def forms_of(region: str, families: Iterable[Family]) -> tuple[Form, ...]:
    """The forms of families; each family has its weight of the prior, its forms equal parts of that."""
    used = [family for family in families if family.leads]
    total = sum(family.weight for family in used)
    return tuple(
        Form(region, family.equation, lead, family.smooth, family.own, math.log(family.weight / total / len(family.leads)))
        for family in used
        for lead in family.leads
    )
