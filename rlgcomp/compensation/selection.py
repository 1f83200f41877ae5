"""Selection of a model's parameters by leaving runs out: in parallel, with progress, and resumable after a kill.

The scores of each batch of candidates are appended to a journal, one JSON line with its checksum; a second run with the same data
and grid resumes from it. The journal begins with a fingerprint of data, folds and grid, so that a stale one is ignored.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Final

import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd
from threadpoolctl import threadpool_limits

from rlgcomp.compensation.models.lssvm_search import selected_text
from rlgcomp.compensation.models.specification import Candidates, Labels, ModelSpecification
from rlgcomp.errors import InputError
from rlgcomp.files import from_json, to_json
from rlgcomp.numerics.compiled import blas_threads
from rlgcomp.numerics.worker_processes import end_with
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
INDEPENDENT_WINDOWS: Final = 10  # of a run, whose errors resemble those of their neighbours: the mean has a tenth of the variance
TIE: Final = 0.01  # candidates whose error is this close to the smallest are equal; the first, the smoothest, is selected
Progress = Callable[[int, int], None]
Scored = tuple[int, list[Any]]  # an error, or its two parts, for each candidate
Work = Callable[[], Scored]
Key = tuple[tuple[str, Any], ...]  # of a candidate
Scores = dict[Key, Any]
logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Selection:
    """Result of a search.

    Parameters
    ----------
    best : dict
        Selected parameters, empty where there is one candidate.
    rmse : float, optional
        Its error with groups left out, in units of the model's output.
    table : pandas.DataFrame
        One row a candidate: its parameters, `rmse`, and whether it was `chosen`.
    at_limits : dict
        Those selected parameters that lie where the search ends.
    """

    best: dict[str, Any]
    rmse: float | None
    table: pd.DataFrame
    at_limits: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def text(self) -> str:
        """The selected parameters in words."""
        return selected_text(self.best)

    def remarks(self, before_deg_h: float, parts: str, about_means_deg_h: tuple[float, float] | None = None) -> list[Message]:
        """Remarks on a search that ends at its limits, and on a model that is no better than none with parts left out.

        Parameters
        ----------
        before_deg_h : float
            Root mean square of the gyro about its mean: the scale of the model's output.
        parts : {"runs", "units"}
            The groups left out.
        about_means_deg_h : (float, float), optional
            Of the gyro, and of what the model leaves with parts left out, each about the mean of every part.
        """
        remarks = [message("compensation.at_limits", parameters=self.at_limits)] if self.at_limits else []
        if self.rmse is not None and self.rmse >= 1.0:
            residual_deg_h = self.rmse * before_deg_h
            if about_means_deg_h is not None and about_means_deg_h[1] < about_means_deg_h[0]:
                before, after = about_means_deg_h
                data = {"residual_deg_h": residual_deg_h, "within_before_deg_h": before, "within_deg_h": after}
                return [*remarks, message("compensation.offsets_between", parts=parts, **data)]
            remarks.append(message("compensation.no_gain", parts=parts, residual_deg_h=residual_deg_h, before_deg_h=before_deg_h))
        return remarks


def select(
    specification: ModelSpecification,
    model: Any,
    X: Array,
    y: Array,
    groups: Labels,
    *,
    journal: Path | None = None,
    n_jobs: int = 1,
    progress: Progress | None = None,
) -> Selection:
    """Search a model's grid for the smallest error on groups left out; of candidates within 1 % of it, the smoothest.

    Where runs differ in their mean by more than their errors scatter about it, as with a bias that is new at each switch-on, no
    candidate can know the mean of a run left out. The mean errors then count only as much as the scatter explains.

    Where the best candidate lies at an edge of the grid, candidates beyond it are tried as well.

    Runs of one programme do not show which of two equally good candidates transfers to another programme; the smoother one does.

    Parameters
    ----------
    specification : ModelSpecification
    model : estimator
        Parameters that are not searched are taken from it.
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Label of the run that each row belongs to; at least two.
    journal : path, optional
        File of finished work.
    n_jobs : int
        Workers, processes or threads as the model needs; each computes with one thread of BLAS.
    progress : callable, optional
        Called with (done, total).
    """
    batches = specification.candidates(model, X.shape[1])
    if not batches:
        (only,) = specification.rmse(model, [{}], X, y, groups).tolist()
        return Selection({}, only, pd.DataFrame({"rmse": [only], "chosen": [True]}))
    fingerprint = _fingerprint(specification, model, batches, X, y, groups) if journal is not None else ""
    scores = _read_journal(journal, fingerprint, [len(batch) for batch in batches])
    if scores and journal is not None:
        logger.info("resuming: %d of %d batches of the search are in %s", len(scores), len(batches), journal)
    # the least smooth, which take the longest, are first, so that no worker ends late with one of them
    waiting = [k for k in reversed(range(len(batches))) if k not in scores]
    if progress:
        progress(len(scores), len(batches))
    in_parallel = _in_threads if specification.threads else _in_processes
    with _appending(journal, fingerprint, scores) as append, blas_threads(1):
        work = [functools.partial(_score, k, specification, model, batches[k], X, y, groups) for k in waiting]
        for k, score in in_parallel(work, max(1, min(joblib.effective_n_jobs(n_jobs), len(waiting)))):
            scores[k] = score
            append(k, score)
            if progress:
                progress(len(scores), len(batches))
        errors = _beyond_the_grid(specification, model, batches, [scores[k] for k in range(len(batches))], X, y, groups)
    rmse, criterion = _rmse_and_criterion(errors)
    if not np.isfinite(criterion).any():
        raise InputError(
            "no setting of the model has a finite error with runs left out; an input may be made of the gyro: leave it out with "
            "--drop NAME, or name the inputs with --features"
        )
    rows = [{**dict(candidate), "rmse": float(error)} for candidate, error in zip(errors, rmse, strict=True)]
    table = pd.DataFrame(rows)
    chosen = int(np.flatnonzero(criterion <= (1.0 + TIE) * np.nanmin(criterion))[0])
    best = {key: value for key, value in rows[chosen].items() if key != "rmse"}
    at_limits = {} if specification.at_limits is None else specification.at_limits(model, X.shape[1], best)
    return Selection(best, float(rows[chosen]["rmse"]), table.assign(chosen=table.index == chosen), at_limits)


def _beyond_the_grid(
    specification: ModelSpecification,
    model: Any,
    batches: list[list[dict[str, Any]]],
    scores: Sequence[Sequence[Any]],
    X: Array,
    y: Array,
    groups: Labels,
) -> Scores:
    """The score of each candidate, and of further ones beyond the grid's edges as long as these are better by more than a tie."""
    errors = {_key(one): score for batch, of in zip(batches, scores, strict=True) for one, score in zip(batch, of, strict=True)}
    while specification.beyond is not None:
        best = list(errors)[int(np.argmin(_rmse_and_criterion(errors)[1]))]
        batches = specification.beyond(model, X.shape[1], batches, dict(best))
        new = [[one for one in batch if _key(one) not in errors] for batch in batches]
        found = {
            _key(one): score
            for batch in new
            if batch
            for one, score in zip(batch, specification.rmse(model, batch, X, y, groups).tolist(), strict=True)
        }
        criterion = _rmse_and_criterion(errors | found)[1]
        if not found or criterion[len(errors) :].min() > (1.0 - TIE) * criterion[: len(errors)].min():
            break
        errors |= found
        errors = {_key(one): errors[_key(one)] for batch in batches for one in batch}
    return errors


def _key(candidate: Mapping[str, Any]) -> Key:
    return tuple(candidate.items())


def _rmse_and_criterion(scores: Scores) -> tuple[Array, Array]:
    """The error of each candidate, and that by which it is selected."""
    errors = np.array(list(scores.values()))
    if errors.ndim == 1:
        return errors, errors
    return np.sqrt((errors**2).sum(axis=1)), _without_run_biases(*errors.T)


def _without_run_biases(between: Array, within: Array) -> Array:
    """The error of each candidate, with mean errors of runs counted by no more than what the scatter within runs explains."""
    best = int(np.argmin(within))
    explained = within[best] ** 2 / INDEPENDENT_WINDOWS
    weight = min(1.0, explained / between[best] ** 2) if between[best] > 0.0 else 1.0
    return np.asarray(np.sqrt(within**2 + weight * between**2))


def _score(
    k: int, specification: ModelSpecification, model: Any, candidates: Candidates, X: Array, y: Array, groups: Labels
) -> Scored:
    return k, specification.rmse(model, candidates, X, y, groups).tolist()


def _in_threads(work: Sequence[Work], workers: int) -> Iterator[Scored]:
    """Results as they end; when the caller stops, work that has not begun is cancelled."""
    with ThreadPoolExecutor(workers) as pool:
        try:
            for done in as_completed([pool.submit(piece) for piece in work]):
                yield done.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _in_processes(work: Sequence[Work], workers: int) -> Iterator[Scored]:
    pool = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", prefer="processes")
    yield from pool(joblib.delayed(_one_thread)(os.getpid(), piece) for piece in work)


def _one_thread(parent: int, piece: Work) -> Scored:
    end_with(parent)
    with threadpool_limits(1):
        return piece()


def _fingerprint(
    specification: ModelSpecification, model: Any, batches: list[list[dict[str, Any]]], X: Array, y: Array, groups: Labels
) -> str:
    digest = hashlib.sha256(json.dumps([specification.name, repr(model), batches], default=str).encode())
    for part in (X, y, np.unique(groups, return_inverse=True)[1]):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def _read_journal(journal: Path | None, fingerprint: str, sizes: Sequence[int]) -> dict[int, list[float]]:
    """Scores of the batches, of so many candidates each, whose lines are whole: their checksums are checked."""
    if journal is None or not journal.exists():
        return {}
    if not journal.is_file():
        raise InputError(f"{journal}, which would hold the finished part of the search, is no file; move it away")
    scores: dict[int, list[float]] = {}
    lines = journal.read_bytes().splitlines()
    with contextlib.suppress(ValueError, KeyError, TypeError):  # a line that a kill or a fault of the disk damaged is done again
        if not lines or from_json(lines[0])["fingerprint"] != fingerprint:
            return {}
    for line in lines[1:]:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            entry = from_json(line)
            k, rmse = entry["piece"], np.asarray(entry["rmse"], dtype=np.float64).tolist()  # JSON has no NaN, but null
            if entry["sha256"] == _line_digest(fingerprint, k, rmse) and 0 <= k < len(sizes) and len(rmse) == sizes[k]:
                scores[k] = rmse
    return scores


def _line_digest(fingerprint: str, k: int, rmse: Sequence[float]) -> str:
    return hashlib.sha256(f"{fingerprint} {k} {np.asarray(rmse, dtype=np.float64).tolist()!r}".encode()).hexdigest()


@contextlib.contextmanager
def _appending(
    journal: Path | None, fingerprint: str, scores: dict[int, list[float]]
) -> Iterator[Callable[[int, list[float]], None]]:
    """Rewrite the journal with the known scores, and yield a function that appends to it."""
    if journal is None:
        yield lambda k, rmse: None
        return
    with journal.open("w", encoding="utf-8") as stream:

        def write(entry: dict[str, Any]) -> None:
            stream.write(to_json(entry, indent=None) + "\n")
            stream.flush()

        def append(k: int, rmse: list[float]) -> None:
            write({"piece": k, "rmse": rmse, "sha256": _line_digest(fingerprint, k, rmse)})

        write({"fingerprint": fingerprint})
        for k, rmse in scores.items():
            append(k, rmse)
        yield append
