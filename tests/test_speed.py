"""Run times against peers: pairs, medians, goals, peers that are missing or disagree, and rows that agree on small data."""

from __future__ import annotations

import gc
import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from experiments import speed
from experiments.speed.__main__ import main
from experiments.speed.against import compare
from experiments.speed.lssvmlab import lssvmlab
from experiments.speed.measure import Case, Peer, Row, Timed, failed, measure
from experiments.speed.page import BEGIN, END, markdown, require_page, shortfalls, write_page
from experiments.speed.reading import recording_table
from experiments.speed.selection import thermal_rows
from rlgcomp.errors import InputError
from rlgcomp.recording.formats import read


@pytest.fixture(scope="module", autouse=True)
def _other_tests_are_no_garbage() -> Iterator[None]:
    """A measurement collects garbage before each repeat, and would look at the modules of thousands of tests."""
    gc.freeze()
    yield
    gc.unfreeze()


def slow() -> float:
    time.sleep(0.02)
    return 1.0


def absent() -> float:
    raise ImportError("absent", name="absent")


def row(*peers: Peer, **goals: float) -> Row:
    return Row("toy", "a toy", lambda quick: Case(lambda: 1.0, peers, size="one"), **goals)


def apart(ours: float, theirs: float) -> float:
    return abs(ours - theirs)


def test_a_slow_peer_is_slower_and_agrees() -> None:
    (found,) = measure(row(Peer("slow", slow, apart, 1e-12, 2.0), goal_s=0.01), repeats=3)
    assert found.ratio > 2.0
    assert found.peer_s == pytest.approx(0.02, abs=0.015)
    assert (found.agrees, found.reached, found.goal) == (True, True, ">= 2 x, <= 0.01 s")


def test_goals_that_are_missed_are_said_and_small_data_are_not_judged() -> None:
    toy = row(Peer("slow", slow, apart, 1e-12, 1e9))
    assert measure(toy, repeats=1)[0].reached is False
    assert measure(toy, repeats=1, quick=True)[0].reached is None


def test_goals_are_judged_by_processor_time_as_well() -> None:
    """On a busy machine one of them decides little; threads share a goal in seconds."""
    peer = Peer("elsewhere", lambda: Timed(1.0, 3.0, 2.0), apart, 0.0, 5.0)
    toy = Row("toy", "a toy", lambda quick: Case(lambda: Timed(1.0, 0.5, 0.5), [peer]))
    (found,) = measure(toy, repeats=1)
    assert (found.reached, found.reached_cpu) == (True, False)
    alone = Row("toy", "a toy", lambda quick: Case(lambda: Timed(1.0, 3.0, 3.0)), threads=2, goal_s=2.0)
    (found,) = measure(alone, repeats=1)
    assert (found.reached, found.reached_cpu) == (False, True)


def test_memory_of_another_process_has_a_goal() -> None:
    toy = Row("toy", "a toy", lambda quick: Case(lambda: Timed(1.0, 3.0, 3.0), peak_MiB=lambda: 2100.0), goal_MiB=2048.0, long=True)
    (found,) = measure(toy, repeats=3)
    assert (found.ours_MiB, found.reached, found.goal) == (2100.0, False, "<= 2048 MiB")


def test_what_misses_something_comes_first_on_the_page(tmp_path: Path) -> None:
    late, good = (Peer("slow", lambda: Timed(1.0, 3.0, 3.0), apart, 0.0, goal) for goal in (9.0, 2.0))
    toys = [
        Row(name, "a toy", lambda quick, peer=peer: Case(lambda: Timed(1.0, 1.0, 1.0), [peer]))
        for name, peer in (
            ("good", good),
            ("late", late),
            ("wrong", Peer("wrong", lambda: Timed(2.0, 9.0, 9.0), apart, 0.0)),
            ("absent", Peer("absent", absent, apart, 0.0)),
        )
    ]
    measured = [*(one for toy in toys for one in measure(toy, repeats=1)), failed(toys[0], ValueError("no number"))]
    kinds = ["failed", "results disagree", "goal missed", "peer not installed"]
    assert [one["what"] for one in shortfalls(measured)] == kinds
    page = tmp_path / "performance.md"
    page.write_text(f"before\n\n{BEGIN}\nold\n{END}\n\nafter\n")
    require_page(page)
    for _ in range(2):
        write_page(page, markdown(measured, {"cores": 2}, "speed"))
    lines = page.read_text().splitlines()
    assert (lines[0], lines[-1], "old" in lines) == ("before", "after", False)
    at = [next(k for k, line in enumerate(lines) if line.startswith(f"| {begin} |")) for begin in (*kinds, "good", "late")]
    assert at == sorted(at)
    require_page(Path(speed.__file__).parents[2] / "docs" / "performance.md")
    page.write_text("no marks")
    with pytest.raises(InputError, match="it lacks the lines"):
        require_page(page)


def test_one_row_that_fails_loses_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = (Row("broken", "a toy", lambda quick: Case(absent)), row(Peer("slow", slow, apart, 0.0)))
    monkeypatch.setattr(speed, "ROWS", rows)
    with pytest.raises(SystemExit, match="2"):
        main(["--repeats", "1", "--out", str(tmp_path / "speed.json"), "--page", str(tmp_path / "page.md")])
    assert [one["failed"] for one in json.loads((tmp_path / "speed.json").read_text())["rows"]] == [True, False]
    assert "failed: ImportError: absent" in (tmp_path / "page.md").read_text()


def test_another_result_is_said() -> None:
    (found,) = measure(row(Peer("wrong", lambda: 2.0, apart, 1e-6)), repeats=1)
    assert (found.agrees, found.disagreement) == (False, 1.0)
    (found,) = measure(row(Peer("not a number", lambda: np.nan, apart, 1e-6)), repeats=1)
    assert found.agrees is False


def test_a_peer_that_is_not_installed_is_said() -> None:
    def missing() -> float:
        import no_such_peer

        return float(no_such_peer.run())

    (found,) = measure(row(Peer("absent", missing, apart, 0.0, 5.0)), repeats=1)
    assert found.note == "peer not installed: no_such_peer"
    assert found.ratio is None
    assert found.reached is None


def test_either_side_may_measure_itself() -> None:
    peer = Peer("elsewhere", lambda: Timed(1.0, 3.0, 2.0), apart, 0.0)
    elsewhere = Row("toy", "a toy", lambda quick: Case(lambda: Timed(1.0, 0.5, 0.5), [peer]))
    (found,) = measure(elsewhere, repeats=2)
    assert (found.peer_s, found.agrees, found.note) == (3.0, True, "ratios 6 to 6")
    assert (found.ratio, found.ratio_cpu) == (6.0, 4.0)


def test_what_takes_long_is_repeated_less_and_says_so() -> None:
    (found,) = measure(row(Peer("long", lambda: Timed(1.0, 4.0, 4.0), apart, 0.0)), repeats=5)
    assert found.note.startswith("2 of 5 repeats; ratios ")
    (found,) = measure(row(Peer("long", lambda: Timed(1.0, 4.0, 4.0), apart, 0.0)), repeats=5, patience_s=20.0)
    assert found.note.startswith("ratios ")
    (found,) = measure(row(Peer("longer", lambda: Timed(1.0, 40.0, 40.0), apart, 0.0, scale=0.5)), repeats=5)
    assert found.note == "1 of 5 repeats; peer extrapolated from 0.5 of the work"


def test_ls_svmlab_needs_octave_and_its_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RLGCOMP_LSSVMLAB", str(tmp_path))
    with pytest.raises(ImportError, match=r"octave-cli|RLGCOMP_LSSVMLAB"):
        lssvmlab(np.zeros((4, 1)), np.zeros(4), np.ones(1), np.ones(1), 2)


def test_work_of_which_the_peer_does_a_part_is_scaled() -> None:
    (whole,) = measure(row(Peer("slow", slow, apart, 0.0)), repeats=3)
    (part,) = measure(row(Peer("slow", slow, apart, 0.0, scale=0.1)), repeats=3)
    assert part.peer_s == pytest.approx(10.0 * whole.peer_s, rel=0.5)
    assert "extrapolated from 0.1" in part.note


def test_names_are_unique_and_chosen_by_their_beginning() -> None:
    names = [one.name for one in speed.ROWS]
    assert len(set(names)) == len(names)
    assert [one.name for one in speed.chosen(["plays"])] == ["plays", "plays-fleet"]
    assert [one.name for one in speed.chosen(["select-430"])] == ["select-430"]
    long = {"diagnose-long", "diagnose-90-days"}
    assert not long & {one.name for one in (*speed.chosen(None), *speed.chosen(["diagnose"]))}
    assert [one.name for one in speed.chosen(["diagnose-long"])] == ["diagnose-long"]
    with pytest.raises(InputError, match="rows are select-430"):
        speed.chosen(["nothing"])


@pytest.mark.parametrize(
    "name",
    [
        "plays",
        "bouc-wen",
        "bouc-wen-fleet",
        "laws-61",
        "laws-built",
        "predict",
        "start-import",
        "allan-octave-1",
        "read-csv",
        "read-parquet",
        "exact-torch",
    ],
)
def test_rows_agree_with_their_peers(name: str) -> None:
    (one,) = (one for one in speed.ROWS if one.name == name)
    found = measure(one, quick=True, repeats=1)
    assert found
    assert all(each.agrees for each in found if not each.note.startswith("peer not installed"))


def test_the_run_that_readers_are_timed_on_needs_no_repair(tmp_path: Path) -> None:
    """At a size where a rare repair would show: then readers that repair nothing would disagree."""
    table = recording_table(1_000_000)
    table.to_parquet(tmp_path / "run.parquet")
    recording = read(tmp_path / "run.parquet")
    assert not recording.findings
    assert np.array_equal(recording.table.to_numpy(), table.to_numpy())


@pytest.mark.parametrize("n", [200, 430, 4300])
def test_selection_is_measured_on_as_many_rows_as_it_says(n: int) -> None:
    X, y, groups = thermal_rows(n)
    assert X.shape == (n, 12)
    assert len(y) == n
    assert np.array_equal(np.bincount(groups), np.full(10, n // 10))


def test_the_command_prints_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "speed.json"
    with pytest.raises(SystemExit, match="0"):
        main(["--quick", "--only", "plays", "--repeats", "1", "--out", str(out)])
    assert "NumPy" in capsys.readouterr().out
    written = json.loads(out.read_text())
    assert {one["row"] for one in written["rows"]} == {"plays", "plays-fleet"}
    assert written["machine"]["cores"] >= 1


@pytest.mark.parametrize("arguments", [["--only", "absent"], ["--out", "/nowhere/at/all.json"]])
def test_bad_input_ends_with_one_message(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["--quick", *arguments])
    assert capsys.readouterr().err.count("error:") == 1


def test_growth_is_the_exponent_of_the_work() -> None:
    def prepare(quick: bool) -> Case:
        n = 300 if quick else 1200
        a = np.random.default_rng(0).normal(size=(n, n))
        return Case(lambda: a @ a, n=n)

    found = speed.growth(Row("product", "a product of matrices", prepare), 5)
    assert found["exponent"] == pytest.approx(3.0, abs=1.0)
    assert speed.growth(Row("toy", "a toy", lambda quick: Case(lambda: 1.0)), 1) is None


def test_growth_may_be_of_more_sizes_with_the_memory_of_each() -> None:
    seconds = [1.0, 2.0, 16.0]
    peaks: list[float] = []

    def sized(k: int) -> Case:
        ours = lambda: peaks.append(100.0 * (k + 1)) or Timed(None, 1.0, seconds[k])  # noqa: E731
        return Case(ours, n=10**k, peak_MiB=lambda: peaks[-1])

    toy = Row("toy", "a toy", lambda quick: Case(lambda: None), sizes=[lambda k=k: sized(k) for k in range(3)])
    found = speed.growth(toy, 1)
    assert (found["n"], found["cpu_s"], found["MiB"]) == ([1, 10, 100], seconds, [100.0, 200.0, 300.0])
    assert found["last_exponent"] == pytest.approx(np.log10(8.0))
    assert found["exponent"] == pytest.approx(np.log10(16.0) / 2.0)
    assert len(peaks) == 3  # work in another process needs no warming


def test_parts_of_the_work_are_said() -> None:
    parts: dict[str, float] = {}
    toy = Row("toy", "a toy", lambda quick: Case(lambda: parts.update(first=0.25, second=1.0), parts=parts))
    (found,) = measure(toy, repeats=1)
    assert found.note == "first 0.25 s, second 1 s"


def test_growth_may_be_of_data_of_their_own() -> None:
    """Where quick data are of another kind; and a piece that measures itself is believed."""

    def grown(small: bool) -> Case:
        n = 2 if small else 8
        return Case(lambda: Timed(None, 1.0, float(n) ** 1.5), n=n)

    found = speed.growth(Row("toy", "a toy", lambda quick: Case(lambda: None), grown=grown), 1)
    assert found["exponent"] == pytest.approx(1.5)


@pytest.mark.slow  # tests of fleets compare one worker with two as well
def test_a_fleet_by_two_workers_is_that_of_one() -> None:
    (row,) = (one for one in speed.ROWS if one.name == "fleet-10")
    (found,) = measure(row, quick=True, repeats=1)
    assert found.agrees
    assert found.size == "10 units"


@pytest.mark.slow  # tests of fleets compare a cluster with one worker as well
@pytest.mark.needs("distributed")
def test_a_fleet_by_a_cluster_that_loses_a_worker_is_that_of_one() -> None:
    killed, _, empty, _ = speed.chosen(["fleet-dask"])
    (found,) = measure(killed, quick=True, repeats=1)
    assert found.agrees
    (found,) = measure(empty, quick=True, repeats=1)
    assert found.size == "50 empty units"


def test_a_row_that_needs_a_library_that_is_not_installed_says_so() -> None:
    def prepare(quick: bool) -> Case:
        raise ImportError("no distributed", name="distributed")

    (found,) = measure(Row("toy", "a toy", prepare))
    assert found.note == "not measured, since it is not installed: distributed"


def test_another_revision_is_measured_in_turn_with_this_tree() -> None:
    root = Path(speed.__file__).parents[2]
    known = subprocess.run(["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, check=False)
    if known.returncode:
        pytest.skip("the tree is no clone of the repository")
    (found,) = compare("HEAD", ["predict"], pairs=2, quick=True)
    assert (found["row"], found["pairs"]) == ("predict", 2)
    for key in ("wall", "cpu"):
        assert 0.0 < found[key]["least"] <= found[key]["median"] <= found[key]["greatest"]
    with pytest.raises(InputError, match="--against no-such-revision"):
        list(compare("no-such-revision", ["predict"], pairs=1, quick=True))
