"""The C lines of a term of known physics: the same arithmetic, in the same order, as :mod:`rlgcomp.compensation.physics_terms`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.errors import InputError
from rlgcomp.numerics.hysteresis import ColemanHodgdon
from rlgcomp.units import SECONDS_PER_MINUTE


@dataclasses.dataclass(frozen=True)
class TermCode:
    """One term in C.

    Parameters
    ----------
    lines : tuple of str
        A block that assigns the term's input.
    begins : tuple of str
        Lines that set its memory at the first sample.
    tables : tuple of (str, tuple of float)
        Constant tables by name.
    helpers : frozenset of str
        Functions of the template that it calls.
    slots, relays : int
        Numbers, and relays, that it remembers.
    filters, operators : int
        Low-pass filters; plays, relays and powers, an addition with a multiplication each.
    """

    lines: tuple[str, ...]
    begins: tuple[str, ...]
    tables: tuple[tuple[str, tuple[float, ...]], ...]
    helpers: frozenset[str]
    slots: int
    relays: int
    filters: int
    operators: int


def term_code(
    term: PhysicsTerm,
    place: int,
    slot: int,
    relay: int,
    monitor: Callable[[str], str],
    number: Callable[[float], str],
) -> TermCode:
    """C of a term.

    Parameters
    ----------
    term : PhysicsTerm
    place : int
        Of its input.
    slot, relay : int
        The first that are its own.
    monitor, number : callable
        The C of a column's value, and of a number.
    """
    return _Writer(term, place, slot, relay, monitor, number).code()


@dataclasses.dataclass
class _Writer:
    term: PhysicsTerm
    place: int
    slot: int
    relay: int
    monitor: Callable[[str], str]
    number: Callable[[float], str]
    begins: list[str] = dataclasses.field(default_factory=list)
    tables: list[tuple[str, tuple[float, ...]]] = dataclasses.field(default_factory=list)
    helpers: set[str] = dataclasses.field(default_factory=set)
    slots: int = 0
    relays: int = 0
    filters: int = 0
    operators: int = 0

    def code(self) -> TermCode:
        term = self.term
        body = [f"const real u = {self._signal()};"] if term.driver else []
        body.append(f"const real m = {self._memory()};")
        value = self._function()
        if term.factor:
            value = f"({value}) * {self.monitor(term.factor)}"
        if term.derivative_s:
            self.helpers.add("low_passed")
            at = f"next.memory[{self.slot + self.slots}]"
            self.slots, self.filters = self.slots + 1, self.filters + 1
            body += [f"const real value = {value};", "", f"{at} = first ? value : {at};"]
            value = f"value - low_passed(&{at}, value, step_s, {self.number(term.derivative_s)})"
        lines = ("{ /* " + _comment(term.names[0]) + " */", *(f"    {line}" if line else "" for line in body))
        lines = (*lines, *([] if body[-1].startswith("next") else [""]), f"    inputs[{self.place}] = {value};", "}")
        return TermCode(
            lines,
            tuple(self.begins),
            tuple(self.tables),
            frozenset(self.helpers),
            self.slots,
            self.relays,
            self.filters,
            self.operators,
        )

    # --- pieces ----------------------------------------------------------------------------------------------------------------

    def _signal(self) -> str:
        term = self.term
        u = self.monitor(term.driver)
        if term.combination == "column":
            return u
        other = self.monitor(term.driver_2)
        if term.combination == "between":
            return f"{u} + {self.number(term.share)} * ({other} - {u})"
        return f"{u} - {other}" if term.combination == "difference" else f"({u} - {other}) / ({u} + {other})"

    def _remember(self, count: int, begin: Callable[[int], str]) -> str:
        first = self.slot + self.slots
        self.slots += count
        self.begins += [f"next.memory[{first + j}] = {begin(j)};" for j in range(count)]
        return f"&next.memory[{first}]"

    def _table(self, name: str, values: Sequence[float]) -> str:
        full = f"TERM{self.place}_{name}"
        self.tables.append((full, tuple(values)))
        return full

    def _memory(self) -> str:
        term, count = self.term, len(self.term.knots)
        signal = f"({self._signal()})" if term.driver else ""
        if term.memory == "time":
            at = self._remember(1, lambda j: self.number(0.0)).removeprefix("&")
            return f"({at} += step_s)"
        if term.memory in ("rate", "lag"):
            at, tau = self._remember(1, lambda j: signal), self.number(term.time_s)
            self.filters += 1
            if term.memory == "rate":
                self.helpers.add("behind")
                return f"{self.number(-SECONDS_PER_MINUTE / term.time_s)} * behind({at}, u, step_s, {tau})"
            self.helpers.add("low_passed")
            return f"low_passed({at}, u, step_s, {tau})"
        if term.memory == "lags":
            self.helpers |= {"behind", "lags"}
            self.filters += count
            at = self._remember(count, lambda j: signal)
            return f"lags({at}, u, step_s, {self._table('TIMES', term.knots)}, {self._table('WEIGHTS', term.weights)}, {count})"
        if term.memory == "plays":
            self.helpers |= {"left_behind", "plays"}
            self.operators += 2 * count
            stood = [self.number(state) for state in term.knots_2]
            at = self._remember(count, lambda j: stood[j] if stood else f"{signal} - {self.number(term.start * term.knots[j])}")
            return f"plays({at}, u, {self._table('RADII', term.knots)}, {self._table('WEIGHTS', term.weights)}, {count})"
        if term.memory in ("bouc_wen", "coleman"):
            self.helpers |= {"left_behind", "decay", term.memory}
            self.operators += 10
            first = self._first_z(signal)
            at = self._remember(3, lambda j: first if j == 1 else signal)
            numbers = ", ".join(map(self.number, term.knots))
            scale = f"{self.number(term.knots[3])} * " if term.memory == "coleman" else ""
            return f"{scale}{term.memory}({at}, u, {numbers})"
        if term.memory == "relays":
            self.helpers.add("relays")
            self.relays, self.operators = count, 2 * count
            at = f"&next.relays[{self.relay}]"
            tables = ", ".join(self._table(name, values) for name, values in (("UP", term.knots), ("DOWN", term.knots_2)))
            levels = self._table("LEVELS", term.levels)
            self.begins.append(f"begin_relays({at}, {signal}, {levels}, {count});")
            return f"relays({at}, u, {tables}, {self._table('WEIGHTS', term.weights)}, {count})"
        return "u"

    def _first_z(self, signal: str) -> str:
        """z of a smooth hysteresis at the first sample."""
        term = self.term
        if term.memory == "bouc_wen":
            return self.number(term.start * term.knots[1])
        _, radius, centre, width = term.knots
        offsets, weights = ColemanHodgdon(radius, centre, width).history(term.start)
        tables = self._table("OFFSETS", tuple(offsets.tolist())), self._table("SHARES", tuple(weights.tolist()))
        return f"first_coleman({signal}, {self.number(centre)}, {self.number(width)}, {', '.join(tables)}, {len(weights)})"

    def _function(self) -> str:
        term, number = self.term, self.number
        centred = f"m - {number(term.centre)}"
        match term.function:
            case "power":
                self.operators += term.order
                return " * ".join([f"({centred})"] * term.order)
            case "magnitude":
                return "m < 0 ? -m : m"
            case "table":
                self.helpers.add("table")
                self.operators += 3 + math.ceil(math.log2(max(2, len(term.table))))
                knots, values = self._table("KNOTS", term.table), self._table("VALUES", term.values)
                cubics = self._table("CUBICS", term.cubics or (0.0,) * 4)
                return f"table(m, {knots}, {values}, {cubics}, {len(term.table)}, {number(term.below)}, {number(term.above)})"
            case "decay":
                self.helpers.add("decay")
                parts = zip(term.values, term.table, strict=True)
                return " + ".join(f"{number(weight)} * decay(m / {number(tau)})" for weight, tau in parts)
            case "cosine" | "sine":
                self.helpers.add("cosine")
                return f"{'cos' if term.function == 'cosine' else 'sin'}({number(2.0 * math.pi * term.table[0])} * m)"
            case "product":
                return f"({centred}) * ({self.monitor(term.driver_2)} - {number(term.centre_2)})"
        return centred


def require_exportable(terms: Sequence[PhysicsTerm], precision: str, *, libm: bool) -> None:
    """Refuse what has no form in this C.

    Raises
    ------
    InputError
        Single precision, or a wave without the C library.
    """
    if terms and precision != "double":
        raise InputError("known physics is exported in double precision; give --precision double")
    waves = [term.mechanism for term in terms if term.function in ("cosine", "sine")]
    if waves and not libm:
        raise InputError(f"{', '.join(dict.fromkeys(waves))} needs cos and sin of the C library; export without --no-libm")


def _comment(text: str) -> str:
    """Text that a C comment can hold."""
    return "".join(character if character.isalnum() or character in " ._-" else "-" for character in text if character.isascii())[
        :120
    ]
