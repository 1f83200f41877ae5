r"""The evidence of a few forms that differ in a basis or two, as one form does from its moves and from what it grows to.

What all of them share is turned to its principal directions beside the set once, and stays with the set, for polishing asks again
and again. Each form is then its own columns beside those
(:meth:`~rlgcomp.diagnosis.evidence.closed_form.Conditional.beside_shared`); columns that several forms have are multiplied once.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.evidence.bank import Scaled
from rlgcomp.diagnosis.evidence.closed_form import Conditional, Shared
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.terms import Form

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_WORTH: Final = 8  # columns that forms share beyond those already turned, from which on they are turned anew
_AT_ONCE: Final = 2_000_000  # numbers of a stack of forms
_MANY: Final = 6  # leading bases, from which on the form is decomposed once and not each of its moves


def gains(given: Conditional, forms: Iterable[Form]) -> tuple[tuple[Form, ...], Array]:
    """Those of some forms that have a scale, and the log evidence with each of each size, shape (forms, sizes)."""
    bank = given.evidence.bank
    listed = list(forms)
    bank.prepare(listed)
    scaled = {form: parts for form in listed if (parts := bank.scaled(form)) is not None}
    if not scaled:
        return (), np.empty((0, len(priors.SIZES)))
    shared = _shared(given, list(scaled.values()))
    own = [tuple(part for part in parts if part not in shared.parts) for parts in scaled.values()]
    found = _beside(given, shared, own)
    for k, form in enumerate(scaled):
        if form.sizes:
            found[k] += np.array(form.sizes)
    return tuple(scaled), found


def gains_of_moves(given: Conditional, form: Form, moves: Sequence[tuple[int, Basis]]) -> Array:
    """Log evidence with a form in which one leading basis is another, of each size, shape (moves, sizes).

    Parameters
    ----------
    given : Conditional
    form : Form
    moves : sequence of (int, Basis)
        The place of the leading basis, and what stands there instead. Minus infinity where the baseline has that.
    """
    bank = given.evidence.bank
    bank.prepare_bases(basis for _, basis in moves)
    if len(form.lead) < _MANY or form.own or any(bank.width(basis) > 1 for basis in (*form.lead, *(basis for _, basis in moves))):
        forms = [form.moved(*move) for move in moves]
        rows = dict(zip(*gains(given, forms), strict=True))
        none = np.full(len(priors.SIZES), -np.inf)
        return np.array([rows.get(one, none) for one in forms]).reshape(len(forms), len(none))
    found = np.full((len(moves), len(priors.SIZES)), -np.inf)
    scales = [bank.scale_of_lead(form, basis) for _, basis in moves]
    possible = [number for number, scale in enumerate(scales) if scale > 0.0]
    if possible and (scaled := bank.scaled(form)) is not None:
        parts = [(moves[number][1], scales[number]) for number in possible]
        found[possible] = _with_one_exchanged(given, scaled, parts, [moves[number][0] for number in possible])
    return found + (np.array(form.sizes) if form.sizes else 0.0)


def _with_one_exchanged(given: Conditional, parts: Scaled, others: Scaled, places: Sequence[int]) -> Array:
    r"""Log evidence with a further form of which one column is another, of each size, shape (others, sizes).

    With the columns B of the form beside the set, :math:`M = I + s^2 B^T B` is decomposed once. Where column r gives way to a,

    .. math::

        \log|M_a| = \log|M| + \log p + \log h, \qquad p = (M^{-1})_{rr}, \qquad
        h = 1 + s^2 a^T a - s^4 \big( c^T M^{-1} c - (M^{-1} c)_r^2 / p \big), \qquad c = B^T a,

    and the quadratic form of the products :math:`v = B^T y` with the data becomes

    .. math:: s^2 \big( v^T M^{-1} v - (M^{-1} v)_r^2 / p \big)
              + \big( s\, a^T y - s^3 ( c^T M^{-1} v - (M^{-1} c)_r (M^{-1} v)_r / p ) \big)^2 / h.

    Parameters
    ----------
    given : Conditional
    parts : sequence of (Basis, float)
        Of the form with their scales, its leading bases first.
    others : sequence of (Basis, float)
        Bases of one column and their scales.
    places : sequence of int
        Column of the form that each stands in for.
    """
    form, own = given.evidence.columns(parts), given.evidence.columns(others)
    cross_of_form, cross = given.reduced_by(form), given.reduced_by(own)
    values, turns = np.linalg.eigh(form.T @ form - cross_of_form.T @ cross_of_form)
    products = form.T @ own - cross_of_form.T @ cross
    products[places, np.arange(len(places))] = 0.0
    along = turns.T @ (form.T @ given.evidence.output - cross_of_form.T @ given.weights_half)
    c, r = products.T @ turns, turns[list(places)]
    square = np.sum(own**2, axis=0) - np.sum(cross**2, axis=0)
    with_data = own.T @ given.evidence.output - cross.T @ given.weights_half
    s = priors.SIZES[:, None]
    grown = 1.0 + s**2 * np.maximum(values, 0.0)  # (sizes, columns of the form)

    def inverse(one: Array, other: Array) -> Array:
        """Products over M, shape (sizes, others)."""
        return np.asarray((1.0 / grown) @ (one * other).T)

    p, of_c, of_data = inverse(r, r), inverse(r, c), inverse(r, along)
    h = np.maximum(1.0 + s**2 * square - s**4 * (inverse(c, c) - of_c**2 / p), 1.0)
    left_for_it = s * with_data - s**3 * (inverse(c, along) - of_c * of_data / p)
    fallen = s**2 * ((1.0 / grown) @ along**2)[:, None] - s**2 * of_data**2 / p + left_for_it**2 / h
    return given.of_changes(np.sum(np.log(grown), axis=1)[:, None] + np.log(p) + np.log(h), fallen).T


def _shared(given: Conditional, scaled: Sequence[Scaled]) -> Shared:
    """What is turned already of the parts that all forms have, or all of these where that is little of them."""
    common = set(scaled[0]).intersection(*scaled[1:])
    known = max((one for one in given.shared if one.parts <= common), key=lambda one: len(one.values), default=None)
    more = sum(given.evidence.bank.width(basis) for basis, _ in common) - (0 if known is None else len(known.values))
    if known is not None and (len(scaled) == 1 or more < _WORTH):
        return known
    found = given.turned([part for part in scaled[0] if part in common] if len(scaled) > 1 and more >= _WORTH else [])
    given.shared.append(found)
    return found


def _beside(given: Conditional, shared: Shared, own: Sequence[Scaled]) -> Array:
    """Log evidence with forms of shared and own parts, of each size, shape (forms, sizes)."""
    bases = list(dict.fromkeys(basis for parts in own for basis, _ in parts))
    columns = given.evidence.columns([(basis, 1.0) for basis in bases])
    edges = np.cumsum([0, *(given.evidence.bank.width(basis) for basis in bases)])
    place = {basis: range(a, b) for basis, a, b in zip(bases, edges[:-1], edges[1:], strict=True)}
    both, cross = shared.columns.T @ columns, given.reduced_by(columns)
    vector = columns.T @ given.evidence.output - cross.T @ given.weights_half
    by_width: dict[int, list[int]] = defaultdict(list)
    index = [np.array([k for basis, _ in parts for k in place[basis]], np.intp) for parts in own]
    scales = [np.array([scale for basis, scale in parts for _ in place[basis]]) for parts in own]
    for k, one in enumerate(index):
        by_width[len(one)].append(k)
    every = len(vector) ** 2 <= sum(len(one) ** 2 for one in index)
    gram = columns.T @ columns - cross.T @ cross if every else None
    found = np.empty((len(own), len(priors.SIZES)))
    for width, numbers in by_width.items():
        at_once = max(1, _AT_ONCE // max(1, width * (width + len(columns) * (not every))))
        for first in range(0, len(numbers), at_once):
            some = numbers[first : first + at_once]
            at, scale = (np.array([table[k] for k in some]).reshape(len(some), width) for table in (index, scales))
            of_own = _products(columns, cross, at) if gram is None else gram[at[:, :, None], at[:, None, :]]
            of_own = of_own * scale[:, :, None] * scale[:, None, :]
            found[some] = given.beside_shared(shared.values, shared.along, both[:, at] * scale, of_own, vector[at] * scale)
    return found


def _products(columns: Array, cross: Array, at: IntArray) -> Array:
    """Products of the columns of each form with one another, beside the set, shape (forms, l, l)."""
    own, of_set = (np.ascontiguousarray(np.moveaxis(table[:, at], 1, 0)) for table in (columns, cross))
    return np.asarray(np.matmul(np.swapaxes(own, 1, 2), own) - np.matmul(np.swapaxes(of_set, 1, 2), of_set))
