"""Noise analysis of a recording larger than memory: read in pieces, with its angle on disk, for the same deviations.

An overlapping deviation at an averaging time tau combines samples 2 tau apart, so that no short buffer suffices. Only the angle is
stored, eight bytes a sample, in a scratch file that the system maps into free memory; sums are taken in blocks of it without a
copy.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_deviation import FEWEST_SAMPLES, Estimator, deviation_of_angle
from rlgcomp.noise.analysis import NoiseAnalysis, deviation_and_coefficients
from rlgcomp.noise.lost_samples import Gaps
from rlgcomp.noise.slopes import curve_findings
from rlgcomp.recording import Recording
from rlgcomp.recording.sampling import GAP_PERIODS
from rlgcomp.report.messages import message
from rlgcomp.scratch import temporary_folder

Array = npt.NDArray[np.float64]
SAMPLES_AT_ONCE: Final = 1 << 20  # samples


def analyse_pieces(
    pieces: Iterable[Recording],
    gyro: str,
    tau_s: npt.ArrayLike | None = None,
    *,
    estimator: Estimator = "overlapping",
    confidence: float = 0.683,
    per_decade: float = 10.0,
    scratch: Path | None = None,
) -> NoiseAnalysis:
    """Noise of one gyro of a recording that is read in pieces, without the lead-in.

    Deviations agree with those of :func:`rlgcomp.noise.analysis.analyse_noise` to rounding. Stationarity, accelerometers,
    temperature and motion are not checked: `stationarity` is None, and a finding says so.

    Parameters
    ----------
    pieces : iterable of Recording
        In order, as :func:`rlgcomp.recording.formats.pieces.read_pieces` gives them.
    gyro : str
        Its column.
    tau_s, estimator, confidence, per_decade
        As in `analyse_noise`; overlapping estimators only.
    scratch : path, optional
        Folder for the scratch file; by default the system's, which the variable TMPDIR names.

    Raises
    ------
    InputError
        The estimator does not overlap, or the record is too short.
    """
    if estimator not in ("overlapping", "hadamard"):
        raise InputError(f"estimator {estimator!r} is not available for a file in pieces; choose overlapping or hadamard")
    with temporary_folder(scratch) as folder:
        path = folder / "angle.f8"
        with path.open("wb") as file:
            record = _write_angle(pieces, gyro, file)
        angle = np.memmap(path, dtype=np.float64, mode="r+", shape=(record.samples + 1,))
        for first in range(0, len(angle), SAMPLES_AT_ONCE):  # the mean is known only after the last piece
            stop = min(first + SAMPLES_AT_ONCE, len(angle))
            angle[first:stop] -= record.mean_above_reference_deg_h * np.arange(first, stop)
        measure = functools.partial(deviation_of_angle, np.asarray(angle), record.gaps, record.period_s)
        deviation, fitted, coefficients = deviation_and_coefficients(measure, tau_s, estimator, confidence, per_decade)
        del measure, angle  # unmapped before the folder goes
    findings = (*curve_findings(fitted, coefficients), message("noise.read_in_pieces"))
    return NoiseAnalysis(gyro, record.mean_deg_h, deviation, coefficients, None, findings)


@dataclasses.dataclass(frozen=True)
class _Record:
    samples: int
    gaps: Gaps
    period_s: float
    mean_deg_h: float
    mean_above_reference_deg_h: float


def _write_angle(pieces: Iterable[Recording], gyro: str, file: BinaryIO) -> _Record:
    """Write cumulative sums of the rate less the first piece's mean, and find the parts between gaps of the whole record."""
    samples, last_angle = 0, 0.0
    ends: list[int] = []
    across_s: list[float] = []
    begin_s = last_s = usual_s = reference = np.nan
    for piece in pieces:
        begin_s = piece.time_s[0] if np.isnan(begin_s) else begin_s
        scored = piece.time_s - begin_s >= piece.metadata.lead_in_s
        time_s, rate = piece.time_s[scored], piece.rate_deg_h(gyro)[scored]
        if not len(rate):
            continue
        if not samples:
            file.write(np.zeros(1).tobytes())
            first_s, usual_s, reference = time_s[0], piece.period_s, float(rate.mean())
        steps = np.diff(time_s, prepend=last_s) if samples else np.diff(time_s)
        breaks = np.flatnonzero(steps > GAP_PERIODS * usual_s)
        ends += (breaks + (samples if samples else 1)).tolist()
        across_s += steps[breaks].tolist()
        angle = last_angle + np.cumsum(rate - reference)
        file.write(angle.tobytes())
        samples, last_angle, last_s = samples + len(rate), float(angle[-1]), time_s[-1]
    if samples < FEWEST_SAMPLES:
        raise InputError(f"{samples} samples after the lead-in; an Allan deviation needs at least {FEWEST_SAMPLES}")
    inside_s = (last_s - first_s - sum(across_s)) / (samples - 1 - len(ends))
    period_s, mean = float(f"{inside_s:.9g}"), last_angle / samples
    gaps = Gaps.of_steps(np.array([*ends, samples]), np.array(across_s), period_s)
    return _Record(samples, gaps, period_s, reference + mean, mean)
