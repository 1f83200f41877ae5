"""Allan sums: the compiled pass over blocks against NumPy, one averaging time after the other."""

from __future__ import annotations

import numpy as np
import pytest

from rlgcomp.errors import InputError
from rlgcomp.noise import allan_octaves as octaves
from rlgcomp.noise import allan_sums as sums
from rlgcomp.noise.allan_deviation import allan_deviation
from rlgcomp.numerics.compiled import available

pytestmark = pytest.mark.skipif(not available(), reason="Numba is not installed, or switched off")
OCTAVES = 2 ** np.arange(0, 13)
MANY = np.unique(np.geomspace(1, 4000, 60).astype(np.int64))


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled from 1000 samples on, in small blocks and pieces, so that short records cross many edges."""
    monkeypatch.setattr(sums, "MANY", 1000)
    monkeypatch.setattr(sums, "BLOCK", 48)
    monkeypatch.setattr(sums, "PIECE", 1024)
    for name, value in {"MANY": 1000, "BLOCK": 48, "CELL": 16, "STRIDE": 64, "ROWS": 512, "LONG": 5000}.items():
        monkeypatch.setattr(octaves, name, value)


def both(rate: np.ndarray, ends: np.ndarray, counts: np.ndarray, order: int, monkeypatch: pytest.MonkeyPatch) -> tuple:
    fast = sums.sums_of_squares(sums.angle_of(rate), ends, counts, order)
    monkeypatch.setenv("RLGCOMP_NUMBA", "0")
    plain = sums.sums_of_squares(sums.angle_of(rate), ends, counts, order)
    monkeypatch.delenv("RLGCOMP_NUMBA")
    return fast, plain


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("counts", [OCTAVES, MANY, MANY[::-1]], ids=["octaves", "many", "falling"])
@pytest.mark.parametrize("ends", [[12_345], [3, 9, 2000, 2001, 9000, 12_345]], ids=["whole", "gaps"])
def test_compiled_sums_are_those_of_numpy(order: int, counts: np.ndarray, ends: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    rate = 10.0 + rng.normal(size=12_345) + np.cumsum(rng.normal(size=12_345)) * 0.01
    longest = int(np.diff(np.r_[0, ends]).max())
    counts = counts[order * counts <= longest]
    (fast, taken), (plain, same) = both(rate, np.array(ends), counts, order, monkeypatch)
    assert (taken == same).all()
    np.testing.assert_allclose(fast, plain, rtol=1e-11)


@pytest.mark.usefixtures("blocks")
def test_the_number_of_threads_changes_no_bit() -> None:
    rate = np.random.default_rng(4).normal(size=20_000)
    one, two = (octaves.overlapping_deviation(rate, OCTAVES, workers) for workers in (1, 2))
    assert (one == two).all()


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("samples", [1000, 1023, 1024, 1025, 4096, 12_345])
@pytest.mark.parametrize(
    "counts", [2 ** np.arange(0, 13), np.array([3, 5, 7, 32, 64, 192, 448]), np.array([64, 128]), np.array([1])], ids=str
)
def test_columns_of_the_record_give_the_deviations_of_the_angle(
    samples: int, counts: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    rate = 10.0 + np.random.default_rng(samples).normal(size=samples)
    counts = counts[2 * counts <= samples]
    fast = octaves.overlapping_deviation(rate, counts)
    monkeypatch.setenv("RLGCOMP_NUMBA", "0")
    np.testing.assert_allclose(fast, octaves.overlapping_deviation(rate, counts), rtol=1e-11)


@pytest.mark.usefixtures("blocks")
def test_columns_are_taken_only_where_they_hold_every_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    rate = np.random.default_rng(8).normal(size=3000)
    from_the_angle: list[list[int]] = []

    def sums_of_squares(angle: np.ndarray, ends: np.ndarray, counts: np.ndarray, *options: object) -> tuple:
        from_the_angle.append(counts.tolist())
        return np.ones(len(counts)), counts

    monkeypatch.setattr(octaves, "sums_of_squares", sums_of_squares)
    for counts in ([1, 32, 64, 128], [1, 33], [1, 65]):
        octaves.overlapping_deviation(rate, np.array(counts))
    assert from_the_angle == [[1, 33], [1, 65]]


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("estimator", ["overlapping", "hadamard"])
def test_the_deviation_with_its_intervals_does_not_change(estimator: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    time_s = np.delete(np.arange(6000.0), np.arange(1000, 1100))
    rate = rng.normal(size=len(time_s))
    fast = allan_deviation(rate, time_s, estimator=estimator)
    monkeypatch.setenv("RLGCOMP_NUMBA", "0")
    plain = allan_deviation(rate, time_s, estimator=estimator)
    np.testing.assert_allclose(fast.deviation_deg_h, plain.deviation_deg_h, rtol=1e-11)
    assert (fast.differences == plain.differences).all()
    assert (fast.edf == plain.edf).all()


def test_a_steady_rate_and_the_shortest_records() -> None:
    counts = np.array([1, 2])
    assert octaves.overlapping_deviation(np.full(4, 7.0), counts).tolist() == [0.0, 0.0]
    assert octaves.overlapping_deviation(np.array([1.0, -1.0, 1.0, -1.0]), counts) == pytest.approx([np.sqrt(2.0), 0.0])


@pytest.mark.parametrize("counts", [[0], [-1], [5], [1.5], [], 3, [[1]]], ids=str)
def test_averaging_times_that_the_record_cannot_hold_are_refused(counts: object) -> None:
    with pytest.raises(InputError, match="whole numbers from 1 to half its length"):
        octaves.overlapping_deviation(np.zeros(8), np.array(counts))


@pytest.mark.needs("allantools")
def test_long_records_agree_with_allantools() -> None:
    import allantools

    rate = np.random.default_rng(6).normal(size=2 * sums.MANY)
    counts = 2 ** np.arange(0, 17)
    _, expected, _, _ = allantools.oadev(rate, rate=1.0, data_type="freq", taus=counts.astype(float))
    np.testing.assert_allclose(octaves.overlapping_deviation(rate, counts), expected, rtol=1e-10)
