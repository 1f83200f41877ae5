r"""Miscounts on a turning table: samples of the gyro that stand off their neighbours as no other passage of the table makes one.

What the gyro shows beyond its table, :math:`r_k = g_k - (1 + K) W_k - b`, jumps by right where the table does: an encoder read
late, lock-in, the table's own jerks. A miscount is one sample or two that are far from the middle of their neighbours,

.. math:: e_k = r_k - \mathrm{med}_{|j| \le 3}\, r_{k+j}, \qquad |e_k| > 12\,\sigma, \qquad |e_k| > 10\, Q_{0.98}(|e_l| : l \in L)

where L are the samples about which the table did at least half as much: turned as fast, sped up as much, as suddenly, and turned
about if it did. Where these are fewer than two passages, of seven samples each, nothing is told: it may be the motion's own.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.numerics.robust import SD_OF_MAD, stretches
from rlgcomp.recording import Recording, motion

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]
_FAR: Final = 12.0  # standard deviations of a sample: no noise is so far out
_FARTHER: Final = 10.0  # times what is usual where the table did as much
_USUAL: Final = 0.98  # of those samples are nearer: another miscount may be among them
_AS_MUCH: Final = 0.5  # of what the table did about a sample, at least
_AROUND: Final = 7  # samples: a passage of the table, and neighbours that tell what is usual
_PASSAGES: Final = 2  # at least, about which it did as much
_LASTS: Final = 2  # samples: a count too many, which the next sample may lack
_MOST: Final = 3  # samples of a run: what stands off more often is the gyro's own


def miscounts_in(run: Recording, gyro: str | None) -> tuple[Rows, Array, str]:
    """Samples of a turning run that stand off as no other passage makes one; by how much in deg/h, zero elsewhere; and what they
    look like, in words.

    None in a run that does not tell how its table moves.
    """
    from scipy.ndimage import median_filter

    none = np.zeros(len(run), dtype=np.bool_), np.zeros(len(run)), ""
    if len(run) < _AROUND * _PASSAGES or not any(column in run for column in (motion.RATE, *motion.ANGLES)):
        return none
    rate_deg_h = run.rate_deg_h(gyro)
    turning_deg_s = motion.reference_rate_deg_s(run, rate_deg_h)
    follows = np.column_stack([np.ones(len(run)), turning_deg_s])
    beyond = rate_deg_h - follows @ np.linalg.lstsq(follows, rate_deg_h, rcond=None)[0]
    off_deg_h = np.where(motion.untold(run), 0.0, beyond - median_filter(beyond, _AROUND, mode="nearest"))
    sample_deg_h = max(SD_OF_MAD * float(np.median(np.abs(off_deg_h))), counting_deg_h(run, gyro))
    far = np.abs(off_deg_h) > _FAR * sample_deg_h
    if not sample_deg_h > 0.0 or not far.any():
        return none
    did = _did(turning_deg_s)
    found = np.zeros(len(run), dtype=np.bool_)
    compared = _Compared.of(np.abs(off_deg_h), did, far)
    for start, stop in stretches(far):
        found[start:stop] = stop - start <= _LASTS and compared.like_no_other(slice(start, stop))
    count = int(found.sum())
    if not 0 < count <= _MOST:
        return none
    furthest = float(np.abs(off_deg_h[found]).max()) / sample_deg_h
    stand, whose = ("samples stand", "their") if count > 1 else ("sample stands", "its")
    said = (
        f"{count} {stand} up to {furthest:.0f} standard deviations off {whose} neighbours, the first at "
        f"{run.time_s[found][0]:.6g} s, as no other passage of the table makes one: a miscount or a fault of the logger"
    )
    return found, np.where(found, off_deg_h, 0.0), said


def without_miscounts(run: Recording, gyro: str | None) -> tuple[Recording, str | None]:
    """A turning run whose gyro's miscounts lie where its table and their neighbours put them, and what to say of them."""
    found, off_deg_h, said = miscounts_in(run, gyro)
    if not said:
        return run, None
    column = run.gyro_column(gyro)
    if column.endswith("_pulses"):
        pulse_deg_h = units.convert((run.metadata.pulse_arcsec or 1.0) / run.period_s, "arcsec/s", "deg/h")
        off = np.rint(off_deg_h / pulse_deg_h)
    else:
        off = units.convert(off_deg_h, "deg/h", units.column_unit(column) or "deg/h")
    table = run.table.assign(**{column: run.column(column) - off})
    put = "put where the table and their neighbours say" if found.sum() > 1 else "put where the table and its neighbours say"
    return run.replace(table=table), f"{run.name}: {said}, {put}."


def counting_deg_h(run: Recording, gyro: str | None) -> float:
    """Standard deviation that whole pulses alone give a sample in deg/h; zero where the gyro is no count of pulses."""
    if not run.gyro_column(gyro).endswith("_pulses") or run.metadata.pulse_arcsec is None:
        return 0.0
    return float(units.convert(run.metadata.pulse_arcsec / (math.sqrt(6.0) * run.period_s), "arcsec/s", "deg/h"))


def _did(turning_deg_s: Array) -> Array:
    """What the table did about each sample, at most: turned, sped up, began or ended to, turned about; shape (n, 4)."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    sped_up = np.abs(np.diff(turning_deg_s, prepend=turning_deg_s[0]))
    jerked = np.abs(np.diff(np.pad(turning_deg_s, 1, "edge"), 2))
    about = maximum_filter1d(turning_deg_s, 3) * minimum_filter1d(turning_deg_s, 3) <= 0.0
    return maximum_filter1d(np.column_stack([np.abs(turning_deg_s), sped_up, jerked, about]), _AROUND, axis=0, mode="nearest")


@dataclasses.dataclass(frozen=True)
class _Compared:
    """How far off samples of a run are, and what the table did about each; of all, and of those that are far off."""

    off: Array  # (n,)
    did: Array  # (n, 4)
    ordered: Array  # each column of it by itself
    far_off: Array  # (m,)
    far_did: Array  # (m, 4)

    @classmethod
    def of(cls, off: Array, did: Array, far: Rows) -> Self:
        return cls(off, did, np.sort(did, axis=0), off[far], did[far])

    def like_no_other(self, samples: slice) -> bool:
        """Whether samples are farther off than any others about which the table did as much."""
        least, far = _AS_MUCH * self.did[samples].max(axis=0), self.off[samples].max()
        if self._surely_like_others(least, float(far)):
            return False
        alike = (self.did >= least).all(axis=1)
        alike[max(0, samples.start - _AROUND) : samples.stop + _AROUND] = False
        if alike.sum() < _AROUND * _PASSAGES:
            return False
        return bool(far > _FARTHER * np.quantile(self.off[alike], _USUAL))

    def _surely_like_others(self, least: Array, far: float) -> bool:
        """It takes no more than a look at what is far off to say so of most: there may be thousands of them."""
        as_much = len(self.did) - max(int(np.searchsorted(column, one)) for column, one in zip(self.ordered.T, least, strict=True))
        as_far = (self.far_off >= far / _FARTHER) & (self.far_did >= least).all(axis=1)
        return bool(as_far.sum() > (1.0 - _USUAL) * as_much + 1.0 + _LASTS + 2 * _AROUND)
