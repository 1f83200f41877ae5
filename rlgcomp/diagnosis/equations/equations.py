"""Equations of mechanisms and laws as LaTeX and as expressions of SymPy, and what their symbols mean.

A mechanism states its equation as a line of text, `b = k_deg_h_K * (lag(T, time_constant_s) - T)`. It is parsed here into a tree
and written in either form: sums, products (written or by juxtaposition), quotients, powers, absolute values, derivatives dT/dt,
functions and numbers with units. What is no such line, such as a sum with dots, is shown as text and has no expression.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from rlgcomp.errors import InputError
from rlgcomp.report.messages.wording import listing

# ("number", text, unit), ("name", text), ("rate", name), ("call", name, arguments), ("op", sign, left, right), ("group", tree), ...
Tree = tuple[Any, ...]
_UNIT: Final = (
    r"(?:deg/s|deg/h|arcsec|degC|deg|uT|hPa|mA|rad/s|m/s\^2|Hz|pulses|ppm|V|K|s|h|d)"
    r"(?:/(?:min|degC|K|h|s|V|uT|hPa|mA|d))*(?![\w/])"
)
_TOKENS: Final = re.compile(
    rf"\s*(?:(?P<number>\d+\.?\d*(?:[eE][-+]?\d+)?)(?:\s(?P<unit>{_UNIT}))?"
    r"|d(?P<rate>[A-Z]|theta)/dt\b|(?P<name>[A-Za-z]\w*)|(?P<sign>[-+*/^(),;|]))"
)
_GREEK: Final = frozenset({"theta", "pi", "alpha", "beta"})
_FUNCTIONS: Final = {"cos": r"\cos", "sin": r"\sin", "exp": r"\exp", "tanh": r"\tanh", "max": r"\max", "sgn": r"\operatorname{sgn}"}


class _NoFormulaError(ValueError):
    """The text is no formula."""


def latex(equation: str, description: str = "") -> str:
    r"""An equation as LaTeX.

    Parameters
    ----------
    equation : str
        The line of text.
    description : str
        A docstring: its first formula stands in where the line is in words.

    Examples
    --------
    >>> latex("b = k_deg_h_min_K * |dT/dt|")
    'b = k \\, \\left|\\dot{T}\\right|'
    """
    left, right = _sides(equation)
    try:
        return f"{left} = {_latex(_parsed(right))}"
    except _NoFormulaError:
        formula = re.search(r"\.\. math::\s*(.+?)\n\s*\n", f"{description}\n\n", re.DOTALL)
        if formula is not None:
            return " ".join(formula[1].split())
        words = re.sub(r"([_%&#$])", r"\\\1", right).replace("^", r"\textasciicircum{}").replace("~", r"\textasciitilde{}")
        return rf"{left} = \text{{{words}}}"


def sympy(equation: str) -> Any:
    """The right side of an equation as an expression of SymPy; parameters and drivers are symbols of their full names.

    Derivatives and operators with memory, as lag(T, time_constant_s), are undefined functions.

    Raises
    ------
    InputError
        SymPy is not installed, or the equation is stated in words.
    """
    try:
        import sympy as library
    except ImportError:
        raise InputError("an expression of SymPy needs SymPy; pip install 'rlgcomp[python]'") from None
    _, right = _sides(equation)
    try:
        return _expression(_parsed(right), library)
    except _NoFormulaError:
        raise InputError(
            f"{equation!r} is stated in words and has no expression; call the finding with a recording instead"
        ) from None


def _sides(equation: str) -> tuple[str, str]:
    left, equals, right = equation.partition(" = ")
    return (left, right.removesuffix(", angles in rad")) if equals else ("b", equation)


def _parsed(text: str) -> Tree:
    tokens, place = [], 0
    while place < len(text.rstrip()):
        found = _TOKENS.match(text, place)
        if found is None:
            raise _NoFormulaError(text)
        tokens.append((str(found.lastgroup) if found["number"] is None else "number", found))
        place = found.end()
    parser = _Parser(tokens)
    tree = parser.sum()
    if parser.sign():
        raise _NoFormulaError(text)
    return tree


class _Parser:
    """Recursive descent over the tokens of a formula."""

    def __init__(self, tokens: list[tuple[str, re.Match[str]]]) -> None:
        self._tokens, self._place, self._bars = tokens, 0, 0

    def sign(self) -> str:
        """The next token as it begins something: its sign, or its kind; empty at the end."""
        if self._place == len(self._tokens):
            return ""
        kind, found = self._tokens[self._place]
        return found["sign"] if kind == "sign" else kind

    def sum(self) -> Tree:
        tree: Tree = self._signed()
        while self.sign() in ("+", "-"):
            tree = ("op", self._take(), tree, self._product())
        return tree

    def _signed(self) -> Tree:
        if self.sign() == "-":
            self._take()
            return ("minus", self._product())
        return self._product()

    def _product(self) -> Tree:
        tree = self._power()
        while True:
            sign = self.sign()
            if sign in ("*", "/"):
                tree = ("op", self._take(), tree, self._power())
            elif sign in ("number", "name", "rate", "(") or (sign == "|" and not self._bars):
                factor = self._power()
                if factor[0] == "name" and len(factor[1]) > 1 and "_" not in factor[1] and factor[1] not in _GREEK:
                    raise _NoFormulaError(factor[1])  # words follow each other
                tree = ("op", "*", tree, factor)
            else:
                return tree

    def _power(self) -> Tree:
        base = self._atom()
        if self.sign() == "^":
            self._take()
            return ("power", base, self._atom())
        return base

    def _atom(self) -> Tree:
        sign = self.sign()
        if sign == "number":
            found = self._next()
            return ("number", found["number"], found["unit"])
        if sign == "rate":
            return ("rate", self._next()["rate"])
        if sign == "name":
            name = self._next()["name"]
            if self.sign() != "(" or "_" in name or len(name) == 1:
                return ("name", name)
            self._take()
            arguments = [self.sum()]
            while self.sign() in (",", ";"):
                self._take()
                arguments.append(self.sum())
            self._expect(")")
            return ("call", name, arguments)
        if sign == "(":
            self._take()
            bars, self._bars = self._bars, 0
            inner = self.sum()
            self._bars = bars
            self._expect(")")
            return ("group", inner)
        if sign == "|":
            self._take()
            self._bars += 1
            inner = self.sum()
            self._bars -= 1
            self._expect("|")
            return ("abs", inner)
        raise _NoFormulaError(sign)

    def _expect(self, sign: str) -> None:
        if self.sign() != sign:
            raise _NoFormulaError(sign)
        self._take()

    def _next(self) -> re.Match[str]:
        self._place += 1
        return self._tokens[self._place - 1][1]

    def _take(self) -> str:
        return str(self._next()["sign"])


def _latex(tree: Tree) -> str:
    match tree:
        case ("number", text, unit):
            mantissa, _, exponent = text.lower().partition("e")
            number = mantissa + (rf" \cdot 10^{{{int(exponent)}}}" if exponent else "")
            return number.removeprefix("1 \\cdot ") + (rf"\,\mathrm{{{unit}}}" if unit else "")
        case ("name", name):
            return _symbol(name)
        case ("rate", name):
            return rf"\dot{{{_symbol(name)}}}"
        case ("group", inner):
            return rf"\left({_latex(inner)}\right)"
        case ("abs", inner):
            return rf"\left|{_latex(inner)}\right|"
        case ("minus", inner):
            return f"-{_latex(inner)}"
        case ("power", base, exponent):
            return f"{{{_latex(base)}}}^{{{_latex(_bare(exponent))}}}"
        case ("call", "sqrt", [argument]):
            return rf"\sqrt{{{_latex(argument)}}}"
        case ("call", name, arguments):
            function = _FUNCTIONS.get(name, rf"\operatorname{{{name}}}")
            return rf"{function}\left({', '.join(map(_latex, arguments))}\right)"
        case ("op", "/", above, below):
            return rf"\frac{{{_latex(_bare(above))}}}{{{_latex(_bare(below))}}}"
        case ("op", "*", one, other):
            return rf"{_latex(one)} \, {_latex(other)}"
        case ("op", sign, one, other):
            return f"{_latex(one)} {sign} {_latex(other)}"
    raise _NoFormulaError(tree)


def _bare(tree: Tree) -> Tree:
    return tree[1] if tree[0] == "group" else tree


def _symbol(name: str) -> str:
    """A parameter or a column without its unit: k_deg_h_K is k, temperature_block_degC is T with an index."""
    if name in _GREEK:
        return rf"\{name}"
    stem = re.sub(r"(_deg_h\w*|_deg_sqrt_h|_deg_s|_arcsec|_ppm\w*|_degC|_hPa|_mA|_uT|_K|_V|_s|_hz)$", "", name)
    head, _, index = stem.partition("_")
    numbered = re.fullmatch(r"([a-z])(\d)", head)
    if numbered:
        return f"{numbered[1]}_{numbered[2]}"
    shown = head if len(head) == 1 else rf"\mathrm{{{head}}}"
    words = index.replace("_", r"\ ")
    return shown + (rf"_{{\mathrm{{{words}}}}}" if index else "")


def _expression(tree: Tree, library: Any) -> Any:
    def of(part: Tree) -> Any:
        return _expression(part, library)

    match tree:
        case ("number", text, _):
            return library.Integer(int(text)) if text.isdigit() else library.Float(text)
        case ("name", "pi"):
            return library.pi
        case ("name", name):
            return library.Symbol(name, real=True)
        case ("rate", name):
            return library.Symbol(f"d{name}_dt", real=True)
        case ("group", inner):
            return of(inner)
        case ("abs", inner):
            return library.Abs(of(inner))
        case ("minus", inner):
            return -of(inner)
        case ("power", base, exponent):
            return of(base) ** of(exponent)
        case ("call", name, arguments):
            known = {"cos": "cos", "sin": "sin", "exp": "exp", "tanh": "tanh", "sqrt": "sqrt", "max": "Max", "sgn": "sign"}
            function = getattr(library, known[name]) if name in known else library.Function(name)
            return function(*map(of, arguments))
        case ("op", sign, one, other):
            left, right = of(one), of(other)
            return {"+": left + right, "-": left - right, "*": left * right}[sign] if sign != "/" else left / right
    raise _NoFormulaError(tree)


# --- symbols -------------------------------------------------------------------------------------------------------------------

_MEANINGS: Final = (
    ("b", r"^b = ", "contribution to the output"),
    ("k", r"\bk(?:_\d)?\b(?!\()", "amplitude: output per unit of what it multiplies"),
    ("u", r"\bu\b", "{drivers}"),
    ("T", r"\bT\b(?!_)", "{temperature}"),
    ("D", r"\bD\b", "{drivers}"),
    ("W", r"\bW\b", "rate of the table"),
    ("theta", r"\btheta\b", "angle of the table"),
    ("t", r"(?<![\w/])t\b", "time since the start of the run"),
    ("d…/dt", r"\bd\w+/dt|\bd\(\w+\)/dt", "rate of change"),
    (
        "play(…; r)",
        r"\bplay\(",
        "play operator: its value stands still while the driver moves within ± r of it, and is dragged along at a distance r "
        "beyond; so the loop of a cycle is 2 r wide",
    ),
    ("r", r"[;,~] r\b|; radius", "threshold of the play, in the driver's unit"),
    ("relay", r"\brelays?\b", "switch that goes up at its upper threshold and down at its lower one, and keeps its state between"),
    ("lag(…)", r"\blag\(", "first-order lag: the driver as seen through an exponential delay of that time constant"),
    ("slab", r"\bslab\b", "layer that conducts heat from the driver's side"),
    ("f", r"\bf\(", "smooth function, drawn below with its band"),
    ("s", r"\bs\(", "output of the simulator"),
    ("c", r"- c\b|\bc - ", "value taken off the driver, in its unit: a corner, or where it is zero"),
    ("p", r"\^p\b", "exponent"),
    ("w", r"/ w\)", "width over which it bends, in the driver's unit"),
    ("w", r"\+ w \(", "how far from the one place to the other, 0 to 1"),
    ("z", r"\bz\b", "inner state of the loop, from -1 to 1"),
)


def symbols(equation: str, drivers: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Symbols of an equation with their meanings, in the order of reading.

    Parameters
    ----------
    equation : str
        As a finding states it.
    drivers : sequence of str
        Columns that it reads.

    Examples
    --------
    >>> symbols("b = k_deg_h_min_K * |dT/dt|", ["temperature_block_degC"])
    [('b', 'contribution to the output'), ('T', 'temperature_block_degC'), ('d…/dt', 'rate of change')]
    """
    named = listing(drivers) or "driver"
    temperature = named if len(drivers) == 1 else "temperature"
    plain = equation.replace("dT/dt", "T d_/dt")
    return [
        (symbol, meaning.format(drivers=named, temperature=temperature))
        for symbol, pattern, meaning in _MEANINGS
        if re.search(pattern, plain if symbol == "T" else equation)
    ]
