"""Commands on sealed challenges: conceal, reveal."""

from __future__ import annotations

import logging
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from rlgcomp.cli.base import AsJson, MechanismFiles, command, progress, require_folder
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_table
from rlgcomp.cli.simulation import SimulatorFile

if TYPE_CHECKING:
    from rlgcomp.challenge.seal import Revealed

REVEALED: Final = ("reveal.json", "report.html", "figures/*.svg")
logger = logging.getLogger(__name__)


@command("conceal", several=("--mechanisms",))
def conceal(
    simulator: SimulatorFile,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder of the challenge.")],
    hide: Annotated[
        str,
        typer.Option(
            metavar="NAME|random|none",
            help="What to hide: mechanisms of the simulator (taken out of its file) or of the catalogue (put into the recordings), "
            "joined by commas; 'random' hides nothing, one or two; 'none' nothing: a healthy gyro.",
        ),
    ] = "random",
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Seed of the choice and of all runs: the same challenge again, and whoever knows or guesses it can open the seal. "
            "By default a secret one, kept in truth.json alone.",
            show_default=False,
        ),
    ] = None,
    strength: Annotated[
        float | None,
        typer.Option(
            metavar="RATIO",
            help="Rms that the simulator cannot fit / white noise of a 100 s mean; unless given 1, or the size in the file.",
        ),
    ] = None,
    step_s: Annotated[float, typer.Option(metavar="S", help="Sample period in s.")] = 1.0,
    mechanisms: MechanismFiles = None,
    as_json: AsJson = False,
) -> None:
    """Seal a challenge: recordings, and a simulator that lacks an effect.

    The truth stays in truth.json, committed by its SHA-256. Hand over everything but truth.json, or do not read it until there is a
    diagnosis.

    Example: `rlgcomp conceal gyro.yaml --hide random --out challenge`
    """
    from rlgcomp.challenge.conceal import conceal as make
    from rlgcomp.challenge.seal import CHALLENGE, FILES, SIMULATOR, TRUTH, seal
    from rlgcomp.errors import InputError
    from rlgcomp.files import sha256
    from rlgcomp.physics.user import user_catalogue
    from rlgcomp.simulation.simulator import Simulator

    require_folder(out, FILES, simulator, mechanisms)
    if (out / CHALLENGE).exists():
        raise InputError(f"{out} holds a challenge already, and a replaced seal proves nothing; give another --out")
    catalogue = user_catalogue(mechanisms or [])
    gyro = Simulator.from_yaml(simulator, catalogue)
    with progress("simulating"):
        concealed = make(gyro, hide, seed=seed, strength=strength, step_s=step_s, catalogue=catalogue)
        seal(concealed, out)
    for remark in concealed.remarks:
        logger.warning("%s", remark)
    if as_json:
        remarks = [remark.to_mapping() for remark in concealed.remarks]
        show_json({"challenge": out / CHALLENGE, "truth_sha256": sha256(out / TRUTH), "remarks": remarks})
        return
    notify(
        f"{out}: sealed; SHA-256 of the truth {sha256(out / TRUTH)} (send it to whoever diagnoses: it binds once others hold it)"
    )
    if seed is not None:
        notify(f"made with --seed {seed}: whoever knows or guesses it can make the challenge again; leave it out for a secret one")
    folder = shlex.quote(str(out))
    runs = f"--train {folder}/train*.parquet --test {folder}/test*.parquet"
    runs += f" --mechanisms {shlex.join(map(str, mechanisms))}" if mechanisms else ""
    notify(f"next: rlgcomp diagnose --simulator {shlex.quote(str(out / SIMULATOR))} {runs} --out DIAGNOSIS")
    notify(f"then: rlgcomp reveal {folder} DIAGNOSIS")


@command("reveal")
def reveal(
    challenge: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the challenge.")],
    diagnosis: Annotated[Path, typer.Argument(metavar="DIAGNOSIS", help="A diagnosis.json, or the folder that diagnose wrote.")],
    truth: Annotated[Path | None, typer.Option(metavar="FILE", help="The truth, where it was kept elsewhere.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Folder for a page: concealed beside found; replaced as a whole."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Open a challenge and score a diagnosis of it.

    Example: `rlgcomp reveal challenge diagnosis --out revealed`
    """
    from rlgcomp.challenge.seal import reveal as opened

    if out is not None:
        require_folder(out, REVEALED, challenge, diagnosis, truth)
    revealed = opened(challenge, diagnosis, truth=truth)
    if out is not None:
        _write(revealed, challenge, diagnosis, out)
    if as_json:
        show_json(revealed.to_mapping())
        return
    score = revealed.score
    hidden = [f"{name} (strength {revealed.strengths[name]:.2g})" for name in revealed.hidden]
    answers = {
        "hidden": ", ".join(hidden) or "nothing",
        "found": ", ".join(revealed.found) or "nothing",
        "verdict": score.verdict,
        "a verdict of the right kind": _yes(score.verdict_right),
        "first finding is hidden": _yes(score.named),
        "exactly the hidden set": _yes(score.exact),
        "right up to indistinguishable mechanisms": _yes(score.in_class),
        "overlap of places in time": "–" if score.overlap is None else f"{100 * score.overlap:.0f} %",
        "less error on the runs held out": _share(revealed.improvement),
        "… with the true law": _share(revealed.possible_improvement),
        "sealed truth, SHA-256": revealed.truth_sha256,
    }
    show_table("Revealed", [{"": question, "answer": answer} for question, answer in answers.items()])
    if score.errors_sd:
        rows = [{"parameter": name, "(estimate - truth) / sd": error} for name, error in score.errors_sd.items()]
        show_table("Parameters", rows)
    if out is not None:
        notify(f"{out}: report.html, reveal.json")


def _write(revealed: Revealed, challenge: Path, diagnosis: Path, out: Path) -> None:
    from rlgcomp.challenge.page import page_of
    from rlgcomp.challenge.seal import CHALLENGE
    from rlgcomp.files import whole_folder, write_json
    from rlgcomp.recording.provenance import provenance

    page = page_of(revealed, challenge, diagnosis)
    answer = diagnosis / "diagnosis.json" if diagnosis.is_dir() else diagnosis
    with whole_folder(out, writes=REVEALED) as folder:
        write_json(folder / "reveal.json", revealed.to_mapping())
        page.write(folder / "report.html", provenance([challenge / CHALLENGE, answer]), figures=folder / "figures")


def _yes(answer: bool) -> str:
    return "yes" if answer else "no"


def _share(value: float | None) -> str:
    return "no run was held out" if value is None else f"{100 * value:.1f} %"
