"""Hysteresis: the laws that define it, other implementations as referees, state handed on bit for bit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import rlgcomp as rlg
from rlgcomp.numerics.hysteresis import BoucWen, ColemanHodgdon, Play, Preisach, duhem_paths

OPERATORS = [
    *(Play((0.5, 2.0, 7.0)), Preisach(-10.0, 10.0, 25), Preisach(-10.0, 10.0, 25, 4.0)),
    *(BoucWen(1.0, 2.0, 0.8, 1.5), ColemanHodgdon(4.0, 1.0, 8.0)),
]
paths = st.lists(st.floats(-9.0, 9.0), min_size=2, max_size=30)


def run(operator: object, path: np.ndarray) -> np.ndarray:
    return operator.run(operator.init(path[0]), path)[0]


def finely(turns: list[float], pieces: int = 40) -> np.ndarray:
    legs = [np.linspace(a, b, pieces, endpoint=False) for a, b in itertools.pairwise(turns)]
    return np.concatenate([*legs, turns[-1:]])


@pytest.mark.parametrize("operator", OPERATORS, ids=repr)
@settings(max_examples=30, deadline=None)
@given(path=paths, cut=st.integers(0, 29))
def test_run_is_the_scan_of_step(operator: object, path: list[float], cut: int) -> None:
    u = np.array(path)
    whole, last = operator.run(operator.init(u[0]), u)
    first, middle = operator.run(operator.init(u[0]), u[:cut])
    second, end = operator.run(middle, u[cut:])
    assert np.array_equal(whole, np.concatenate([first, second]))
    state = operator.init(u[0])
    for x in path:
        state = operator.step(state, x)
    assert np.array_equal(state, last)
    assert np.array_equal(end, last)


@pytest.mark.parametrize("operator", OPERATORS[:3], ids=repr)
@settings(max_examples=30, deadline=None)
@given(path=paths, seed=st.integers(0, 1000))
def test_speed_does_not_matter(operator: object, path: list[float], seed: int) -> None:
    """Rate independence: passing through the same turning points with other samples in between ends in the same state."""
    rng = np.random.default_rng(seed)
    other = [path[0]]
    for a, b in itertools.pairwise(path):
        other += [*(a + (b - a) * np.sort(rng.uniform(size=3))), b]
    assert run(operator, np.array(other))[-1] == pytest.approx(run(operator, np.array(path))[-1], abs=1e-12)


@pytest.mark.parametrize("operator", OPERATORS[:3], ids=repr)
def test_wiping_out_and_return_point_memory(operator: object) -> None:
    """A minor loop leaves no trace once its turning point is passed again (Preisach, play)."""
    with_loop = run(operator, finely([0.0, 8.0, -6.0, 4.0, -2.0, 4.0, 6.0]))
    without = run(operator, finely([0.0, 8.0, -6.0, 6.0]))
    assert with_loop[-1] == pytest.approx(without[-1], abs=1e-12)
    returned = run(operator, finely([0.0, 8.0, 1.0, 5.0, 1.0]))
    assert returned[-1] == pytest.approx(returned[2 * 40], abs=1e-12)


@pytest.mark.parametrize("operator", OPERATORS, ids=repr)
@pytest.mark.parametrize("swept", [1, -1])
def test_a_swept_start_is_what_a_sweep_leaves(operator: object, swept: int) -> None:
    far = -10.0 * swept if isinstance(operator, Preisach) else -60.0 * swept  # a Preisach plane ends there
    _, left = operator.run(operator.init(far), finely([far, 3.0], 8000))
    np.testing.assert_allclose(operator.init(3.0, swept), left, atol=1e-6)
    assert not np.allclose(operator.init(3.0), left, atol=0.1)


def test_play_by_its_definition() -> None:
    u = np.random.default_rng(0).standard_normal(500).cumsum()
    states = run(Play((1.3,)), u)[:, 0]
    w = u[0]
    for k, x in enumerate(u):
        w = max(x - 1.3, min(x + 1.3, w))
        assert states[k] == w


def test_play_is_a_uniform_preisach_plane_of_one_width() -> None:
    """A play of radius r is an infinite row of relays whose thresholds are 2r apart: the referee is built of single relays."""
    radius, u = 2.0, finely([0.0, 7.0, -3.0, 5.0, 1.0, 6.0, -7.0])
    centres = np.linspace(-20.0, 20.0, 4001)
    up = np.where(centres < u[0], 1.0, -1.0)
    total = []
    for x in u:
        up[x >= centres + radius] = 1.0
        up[x <= centres - radius] = -1.0
        total.append(0.5 * np.sum(up) * (centres[1] - centres[0]))
    assert run(Play((radius,)), u)[:, 0] == pytest.approx(np.array(total), abs=0.02)


def test_preisach_saturates_and_is_symmetric() -> None:
    relays = Preisach(-10.0, 10.0, 30, 2.0)
    assert run(relays, np.array([0.0, 10.0])) == pytest.approx([0.0, 1.0], abs=0.05)
    loop = run(relays, finely([0.0, 10.0, -10.0, 10.0]))
    assert loop[40:81] == pytest.approx(-loop[80:121], abs=1e-12)


@pytest.mark.parametrize(("shape", "exponent"), [(0.8, 1.0), (1.0, 2.0), (0.6, 1.5)])
def test_bouc_wen_solves_its_equation(shape: float, exponent: float) -> None:
    """Against an adaptive integrator of the same law in time."""
    law = BoucWen(1.5, 2.0, shape, exponent)
    strength = 1.5 / 2.0**exponent
    beta, gamma = shape * strength, (1 - shape) * strength

    def u(t: float) -> float:
        return 6.0 * np.sin(t) * np.exp(-0.1 * t)

    def rhs(t: float, z: np.ndarray) -> np.ndarray:
        rate = (6.0 * np.cos(t) - 0.6 * np.sin(t)) * np.exp(-0.1 * t)
        return 1.5 * rate - beta * abs(rate) * abs(z) ** (exponent - 1) * z - gamma * rate * abs(z) ** exponent

    time = np.linspace(0.0, 12.0, 4001)
    exact = solve_ivp(rhs, (0.0, 12.0), [0.0], t_eval=time, rtol=1e-9, atol=1e-10, max_step=0.01).y[0]
    assert run(law, np.array([u(t) for t in time])) == pytest.approx(exact, abs=3e-4)


def test_coleman_hodgdon_solves_its_equation() -> None:
    operator = ColemanHodgdon(radius=5.0, centre=3.0, width=12.0)
    turns = [0.0, 20.0, -15.0, 10.0]
    u, z = finely(turns, 2000), [operator.init(0.0)[0]]
    for a, b in itertools.pairwise(turns):

        def slope(x: float, y: np.ndarray, way: float = np.sign(b - a)) -> np.ndarray:
            return way * (np.tanh((x - 3.0) / 12.0) - y) / 5.0

        z += solve_ivp(slope, (a, b), [z[-1]], t_eval=np.linspace(a, b, 2001)[1:], rtol=1e-9, atol=1e-12).y[0].tolist()
    np.testing.assert_allclose(run(operator, u), z, atol=1e-6)


def test_loops_about_two_curves_are_those_of_coleman_hodgdon_and_of_bouc_wen_where_they_are_the_same_law() -> None:
    u = finely([0.0, 20.0, -15.0, 10.0, -4.0], 2000)
    middles = 0.5 * (u + np.r_[u[:1], u[:-1]])
    operator = ColemanHodgdon(radius=5.0, centre=3.0, width=12.0)
    curve = np.tanh((middles - 3.0) / 12.0)[:, None]
    np.testing.assert_allclose(duhem_paths(u, 5.0, curve, curve)[:, 0], run(operator, u), atol=1e-12)
    limits = np.full((len(u), 1), 2.5)  # dz = A du - β |du| z goes to ± A / β
    np.testing.assert_allclose(duhem_paths(u, 2.5 / 1.5, limits, -limits)[:, 0], run(BoucWen(1.5, 2.5, 1.0, 1.0), u), atol=1e-4)


def test_loops_about_two_curves_solve_their_equation() -> None:
    turns = [0.0, 20.0, -15.0, 10.0]
    u = finely(turns, 2000)
    middles = 0.5 * (u + np.r_[u[:1], u[:-1]])
    rising, falling = (lambda x: np.sin(x / 9.0)), (lambda x: 0.3 * np.cos(x / 5.0) - 0.4)
    z = [0.5 * (rising(0.0) + falling(0.0))]
    for a, b in itertools.pairwise(turns):

        def slope(x: float, y: np.ndarray, way: float = np.sign(b - a)) -> np.ndarray:
            return way * ((rising if way > 0.0 else falling)(x) - y) / 6.0

        z += solve_ivp(slope, (a, b), [z[-1]], t_eval=np.linspace(a, b, 2001)[1:], rtol=1e-9, atol=1e-12).y[0].tolist()
    np.testing.assert_allclose(duhem_paths(u, 6.0, rising(middles)[:, None], falling(middles)[:, None])[:, 0], z, atol=1e-5)


def test_coleman_hodgdon_is_the_narrower_where_its_curve_saturates() -> None:
    operator = ColemanHodgdon(radius=5.0, centre=0.0, width=10.0)
    z = run(operator, finely([0.0, 60.0, -60.0, 60.0], 4000))
    cooling, heating = np.split(z[4000:12_000], 2)
    opened = np.interp([0.0, 30.0], np.linspace(-60.0, 60.0, 4000), cooling[::-1] - heating)
    assert opened[1] < 0.1 * opened[0]


def test_bouc_wen_saturates() -> None:
    assert run(BoucWen(1.0, 2.5, 0.8, 1.0), np.linspace(0.0, 100.0, 300))[-1] == pytest.approx(2.5, rel=1e-6)


@pytest.mark.parametrize(
    "make", [lambda: Play(()), lambda: Play((-1.0,)), lambda: Preisach(1.0, 0.0), lambda: BoucWen(saturation=0.0)]
)
def test_impossible_parameters_are_refused(make: object) -> None:
    with pytest.raises(rlg.InputError):
        make()
