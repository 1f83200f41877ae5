"""Families of forms of the time: what dies away since switch-on, and what goes on since then or by a clock of all runs."""

from __future__ import annotations

from rlgcomp.diagnosis.forms.bases import Basis, Own
from rlgcomp.diagnosis.forms.terms import Family
from rlgcomp.diagnosis.forms.times import Since, SmoothSince
from rlgcomp.diagnosis.regions.setting import Setting
from rlgcomp.physics.ageing import Ageing


def _kin_of_time(setting: Setting) -> tuple[Basis, ...]:
    return (SmoothSince(setting.data.runs[0].grid.window_s, setting.data.longest_s, 0.5, 8),)


def warm_up(setting: Setting) -> list[Family]:
    times = setting.time_constants_s(1.0, 0.6)
    ratio, kin, longest = times[1] / times[0], _kin_of_time(setting), setting.data.longest_s
    single = [(Since("exponential", t, setting.data.longest_s, ratio),) for t in times]
    pairs = [(*single[k], *single[k + apart]) for apart in (3, 5) for k in range(len(times) - apart)]
    return [
        Family("b = initial * exp(-t / time_constant_s)", single, kin, 2.0),
        Family(
            "b = initial * exp(-(t / time_constant_s)^q)",
            [(Since("exponential", t, longest, ratio, q),) for t in times for q in (0.5, 0.75)],
            kin,
        ),
        Family(
            "b = initial * (1 + t / time_constant_s)^-q",
            [(Since("hyperbola", t, longest, ratio, q),) for t in times for q in (1.0, 1.7, 2.5)],
            kin,
        ),
        Family("b = a exp(-t / time_constant_s) + c exp(-t / slower_time_constant_s)", pairs, kin),
    ]


def ageing(setting: Setting) -> list[Family]:
    times, longest, kin = setting.time_constants_s(0.3, 0.3), setting.data.longest_s, _kin_of_time(setting)
    ratio = times[1] / times[0]
    by_clock = [Own(one) for one in Ageing.grid([run.binned for run in setting.data.runs]) if one.since == "clock"]
    return [
        Family("b = k t", [(Since("power", 1.0, longest),)], kin, 2.0),
        *(Family("b = k t, t by the clock of all runs", [(basis,)]) for basis in by_clock),
        Family("b = k ln(1 + t / time_constant_s)", [(Since("logarithm", t, longest, ratio),) for t in times[::2]], kin),
        Family("b = k t^exponent", [(Since("power", p, longest),) for p in (0.3, 0.5, 0.7, 1.5, 2.0)], kin),
    ]
