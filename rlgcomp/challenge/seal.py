"""The folder of a challenge: sealed before a diagnosis, opened and scored after it.

`challenge.json`, `simulator.yaml` and the recordings are for whoever diagnoses; `truth.json` is kept back, or not read, until there
is a diagnosis. The challenge holds the SHA-256 of the truth, and the truth holds a random salt: it cannot be changed afterwards,
nor found by hashing every answer that the catalogue allows. The truth in turn holds the content of the challenge and the SHA-256 of
its other files. Only a copy of the hash in other hands protects against a forged truth with its own hash.

Whoever knows the seed can make the challenge again with each cause in turn and compare: unless one is given, it is a secret number
of 128 bits, kept in the truth alone.
"""

from __future__ import annotations

import dataclasses
import math
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from rlgcomp.challenge.conceal import RUNS, TRAINING, Challenge
from rlgcomp.challenge.score import Hidden, Score
from rlgcomp.errors import InputError
from rlgcomp.files import from_json, read_text, sha256, whole_folder, write_json
from rlgcomp.recording.formats import write

CHALLENGE: Final = "challenge.json"
TRUTH: Final = "truth.json"
SIMULATOR: Final = "simulator.yaml"
FILES: Final = (CHALLENGE, TRUTH, SIMULATOR, *(f"{name}.parquet" for name in RUNS))
CHALLENGE_SCHEMA: Final = "rlgcomp.challenge/1"
TRUTH_SCHEMA: Final = "rlgcomp.truth/1"
_SALT_BYTES: Final = 32
_LONGEST_NAME: Final = 200


@dataclasses.dataclass(frozen=True)
class Revealed:
    """A challenge opened and a diagnosis scored.

    Parameters
    ----------
    hidden : mapping
        By mechanism, its parameters as they acted.
    strengths : mapping of str to float
    found : tuple of str
        The diagnosis's findings.
    score : Score
    improvement, possible_improvement : float, optional
        On the held-out runs: of the diagnosis, and of the true law; None where the diagnosis held no run out.
    truth_sha256 : str
        Of the truth that it was scored against, to be compared with a copy made when the challenge was sealed.
    """

    hidden: Mapping[str, Mapping[str, Any]]
    strengths: Mapping[str, float]
    found: tuple[str, ...]
    score: Score
    improvement: float | None
    possible_improvement: float | None
    truth_sha256: str

    def to_mapping(self) -> dict[str, Any]:
        """Plain data."""
        return dataclasses.asdict(self) | {"score": self.score.to_mapping()}


def seal(challenge: Challenge, folder: str | Path) -> None:
    """Write a challenge as a folder, whole or not at all.

    Raises
    ------
    InputError
        The folder exists and is no challenge, or cannot be written.
    """
    with whole_folder(folder, writes=FILES) as scratch:
        challenge.simulator.to_yaml(scratch / SIMULATOR)
        for recording in (*challenge.train, *challenge.test):
            write(recording, scratch / f"{recording.name}.parquet")
        runs = [f"{name}.parquet" for name in RUNS]
        public = {
            "schema": CHALLENGE_SCHEMA,
            "kind": challenge.simulator.kind,
            "simulator": SIMULATOR,
            "train": runs[:TRAINING],
            "test": runs[TRAINING:],
            "truth": TRUTH,
        }
        truth = {
            "schema": TRUTH_SCHEMA,
            "salt": secrets.token_hex(_SALT_BYTES),
            "seed": challenge.seed,
            "challenge": public,
            "hidden": {mechanism.name: mechanism.to_mapping() for mechanism in challenge.mechanisms},
            "strengths": dict(challenge.strengths),
            "parameters": dict(challenge.hidden.parameters),
            "intervals": dict(challenge.hidden.intervals),
            "possible_rms_deg_h": challenge.possible_rms_deg_h,
            "possible_by_averaging_s": [list(one) for one in challenge.possible_by_averaging_s.items()],
            "files": {name: sha256(scratch / name) for name in (SIMULATOR, *runs)},
        }
        write_json(scratch / TRUTH, truth)
        write_json(scratch / CHALLENGE, public | {"truth_sha256": sha256(scratch / TRUTH)})


def reveal(folder: str | Path, diagnosis: str | Path, *, truth: str | Path | None = None) -> Revealed:
    """Open a challenge and score a diagnosis of it.

    Parameters
    ----------
    folder : path
    diagnosis : path
        A diagnosis.json, or the folder it lies in.
    truth : path, optional
        The truth, where it was kept elsewhere.

    Raises
    ------
    InputError
        The truth is not the one that was sealed, a file of the challenge was changed, the diagnosis is one of other recordings or
        holds impossible values, or a file is of another schema.
    """
    folder, diagnosis = Path(folder), Path(diagnosis)
    challenge = _content(folder / CHALLENGE, CHALLENGE_SCHEMA)
    truth_file = folder / _plain_name(challenge.get("truth", TRUTH), folder / CHALLENGE) if truth is None else Path(truth)
    if not truth_file.is_file():
        raise InputError(
            f"{truth_file} does not exist: the truth of the challenge; give it with --truth where it was kept elsewhere"
        )
    if sha256(truth_file) != challenge.get("truth_sha256"):
        raise InputError(
            f"{truth_file} is not the truth that was sealed: its SHA-256 is {sha256(truth_file)}, the challenge's is "
            f"{challenge.get('truth_sha256')}; nothing is scored against it"
        )
    sealed = _content(truth_file, TRUTH_SCHEMA)
    answer = _content(diagnosis / "diagnosis.json" if diagnosis.is_dir() else diagnosis, "rlgcomp.diagnosis/1")
    try:
        return _scored(folder, challenge, sealed, answer)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{folder / CHALLENGE}, {truth_file} or the diagnosis {diagnosis} is not as it was written: {type(error).__name__}: "
            f"{error}; give the files that conceal and diagnose wrote, unchanged"
        ) from None


def _scored(folder: Path, challenge: Mapping[str, Any], sealed: Mapping[str, Any], answer: Mapping[str, Any]) -> Revealed:
    public = {name: value for name, value in challenge.items() if name != "truth_sha256"}
    edited = sorted(name for name in {*public, *sealed["challenge"]} if public.get(name) != sealed["challenge"].get(name))
    if edited:
        raise InputError(
            f"{folder / CHALLENGE} is not as it was written: {', '.join(edited)} changed since it was sealed; nothing is scored"
        )
    names = {_plain_name(name, folder / TRUTH): digest for name, digest in sealed["files"].items()}
    changed = [name for name, digest in names.items() if not (folder / name).is_file() or sha256(folder / name) != digest]
    if changed:
        raise InputError(f"{folder}: {', '.join(changed)} changed or gone since the challenge was sealed; nothing is scored")
    _require_same_recordings(challenge, sealed["files"], answer)
    intervals = {run: [(float(a), float(b)) for a, b in spans] for run, spans in sealed["intervals"].items()}
    parameters = {name: float(value) for name, value in sealed["parameters"].items()}
    score = Score.of(Hidden(tuple(sealed["hidden"]), parameters, intervals), answer)
    strengths = {name: float(sealed["strengths"][name]) for name in sealed["hidden"]}
    improvement, possible = _improvements(answer, float(sealed["possible_rms_deg_h"]), sealed.get("possible_by_averaging_s") or ())
    findings = tuple(str(finding["mechanism"]) for finding in answer["findings"])
    return Revealed(sealed["hidden"], strengths, findings, score, improvement, possible, challenge["truth_sha256"])


def _require_same_recordings(challenge: Mapping[str, Any], sealed: Mapping[str, str], answer: Mapping[str, Any]) -> None:
    """Refuse a diagnosis that trained on other files than the challenge's, where it names its files."""
    for part, files in (answer.get("recordings") or {}).items():
        if part == "simulator":  # the user's own simulator may have been used too
            continue
        allowed = {sealed[name] for name in challenge.get(part, ())}
        foreign = sorted(name for name, digest in files.items() if digest not in allowed)
        if foreign:
            raise InputError(
                f"the diagnosis is not one of this challenge: {', '.join(foreign)} ({part}) is none of its {part} runs, "
                f"{', '.join(challenge.get(part, ()))}; give the diagnosis of these files as they are"
            )


def _improvements(
    answer: Mapping[str, Any], possible_rms_deg_h: float, by_averaging_s: Sequence[Sequence[float]]
) -> tuple[float | None, float | None]:
    """Gains on the held-out runs of what was found and of the true law, both in the answer's own windows."""
    held_out: Mapping[str, Any] = (answer.get("fit") or {}).get("test") or {}
    try:
        before, after = float(held_out["baseline_rms"]), float(held_out["augmented_rms"])
    except (KeyError, TypeError, ValueError):
        return None, None
    if not (math.isfinite(before) and math.isfinite(after)):
        raise InputError(f"fit.test has rms {before:g} and {after:g} in the diagnosis; give diagnosis.json as diagnose wrote it")
    if not before > 0.0:
        return None, None
    if by_averaging_s and held_out.get("averaging_s"):
        times_s, rms_deg_h = np.array(by_averaging_s, dtype=np.float64).T
        possible_rms_deg_h = math.exp(np.interp(math.log(float(held_out["averaging_s"])), np.log(times_s), np.log(rms_deg_h)))
    return 1.0 - after / before, 1.0 - possible_rms_deg_h / before


def _plain_name(name: Any, stated_in: Path) -> str:
    """A name of a file in the challenge's own folder."""
    if not isinstance(name, str) or not name or Path(name).name != name or len(name) > _LONGEST_NAME or not name.isprintable():
        raise InputError(f"{stated_in} names the file {str(name)[:80]!r}, which lies in no challenge; give the files unchanged")
    return name


def _content(path: Path, schema: str) -> dict[str, Any]:
    try:
        content = from_json(read_text(path))
    except FileNotFoundError:
        raise InputError(
            f"{path} does not exist; give a challenge that `rlgcomp conceal` wrote and a diagnosis that `rlgcomp diagnose` wrote"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not readable as JSON: {error}") from None
    if not isinstance(content, dict) or content.get("schema") != schema:
        raise InputError(f"{path} is no {schema}: its schema is {content.get('schema') if isinstance(content, dict) else None!r}")
    return content
