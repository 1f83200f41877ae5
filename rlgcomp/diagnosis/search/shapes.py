"""Free shapes of the simulator beside a set: they enter by their derivatives, so they are calibrated anew beside what was found."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Evidence, Member, Set, columns_of
from rlgcomp.diagnosis.forms.bases import Own
from rlgcomp.diagnosis.search.states import State
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
LIKELIER: Final = 3.0  # nats from which on the search is run again with them
_OF_A_MEMBER: Final = 9.0  # of its prior, in nats, about: without it a set may have so much less


def columns_beside(state: State, bank: Bank) -> Array:
    """Columns of a set and its path of jumps, their weights about as large as the white noise, shape (n, r)."""
    return np.hstack([columns_of(bank, _effects(state)), _path(state, bank.data)])


def wrong_amplitudes(state: State) -> dict[str, set[str]]:
    """By mechanism of the simulator, the amplitudes that a set has as stated wrong."""
    found: dict[str, set[str]] = {}
    for own in filter(None, map(_wrong_number, state.members)):
        found.setdefault(own.mechanism.name, set()).add(own.mechanism.amplitude_parameters()[own.column].name)
    return found


def likelier(state: State, now: Bank, before: Bank) -> bool:
    """Whether a set, or one with a member less, is clearly likelier beside one calibrated simulator than beside another."""
    members, path = _effects(state), _path(state, now.data)
    banks = [now, before]
    if state.process is not None:
        banks = [Bank(one.data, np.hstack([one.design, path]), one.baseline) for one in banks]
    new, old = (Evidence(one, state.noise, 0.0) for one in banks)
    if new.log_evidence(members) > old.log_evidence(members) + LIKELIER:
        return True
    least = old.log_evidence(members) - _OF_A_MEMBER
    fewer = [(*members[:k], *members[k + 1 :]) for k in range(len(members))]
    return any(new.log_evidence(one) > max(old.log_evidence(one) + LIKELIER, least) for one in fewer)


def renewed(state: State, simulator: Simulator) -> State:
    """A set whose wrong numbers are of the simulator's mechanisms with their shapes."""
    mechanisms, members = {mechanism.name: mechanism for mechanism in simulator.mechanisms}, []
    for member in state.members:
        own, form = _wrong_number(member), member.form
        if own is not None:
            form = dataclasses.replace(form, lead=(dataclasses.replace(own, mechanism=mechanisms[own.mechanism.name]),))
        members.append(Member(form, member.size))
    return dataclasses.replace(state, members=tuple(members))


def _effects(state: State) -> Set:
    return tuple(member for member in state.members if _wrong_number(member) is None)


def _wrong_number(member: Member) -> Own | None:
    """The stated amplitude of the simulator that a member says is wrong; None of another member."""
    lead = member.form.lead[0] if member.form.lead else None
    return lead if isinstance(lead, Own) and lead.column is not None else None


def _path(state: State, data: Data) -> Array:
    """The process beside a set over the white noise, shape (n, 1); (n, 0) without any."""
    seen = state.process
    return np.empty((len(data), 0)) if seen is None else seen.path[:, None] * seen.half_step / seen.sigma
