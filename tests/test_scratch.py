"""Outputs take their names at once, and what a killed process left is finished or removed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rlgcomp import scratch
from rlgcomp.errors import InputError
from rlgcomp.files import require_folder, require_replaceable, whole_file, whole_folder, write_result, write_text
from rlgcomp.scratch import PREFIX, recover


def names(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


STOPS = """
import os, sys, time
from pathlib import Path
from rlgcomp.files import whole_file, whole_folder
place = Path(sys.argv[1])
with whole_folder(place / "out", writes=("mine",)) as folder, whole_file(place / "run.csv", overwrite=True) as file:
    (folder / "mine").write_text("new")
    file.write_text("new")
    print(flush=True)
    time.sleep(60)
"""
KILLED_BETWEEN = """
import os, sys
from pathlib import Path
from rlgcomp import scratch
from rlgcomp.files import whole_file, whole_folder
place, last = Path(sys.argv[1]), int(sys.argv[2])
scratch.exchange = lambda one, other: False
calls, replace = [], os.replace
def counted(one, other):
    calls.append(one)
    if len(calls) > last:
        os.kill(os.getpid(), 9)
    replace(one, other)
os.replace = counted
if sys.argv[3] == "folder":
    with whole_folder(place / "out", writes=("mine",)) as folder:
        (folder / "mine").write_text("new")
elif sys.argv[3] == "folder and file":
    with whole_folder(place / "out", writes=("mine",)) as folder:
        (folder / "mine").write_text("new")
        (folder.parent / "run.csv").write_text("new")
else:
    with whole_file(place / "run.csv", overwrite=True) as file:
        file.write_text("new")
        file.with_suffix(".yaml").write_text("new")
"""


def test_scratch_of_a_killed_process_is_removed_by_the_next_and_that_of_a_living_one_is_not(tmp_path: Path) -> None:
    for number in (signal.SIGKILL, None):
        process = subprocess.Popen([sys.executable, "-c", STOPS, str(tmp_path)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        left = {path.name for path in tmp_path.iterdir()}
        assert all(name.startswith(PREFIX) for name in left)
        assert len(left) == 2
        if number is not None:
            process.send_signal(number)
            process.wait()
            assert {path.name for path in tmp_path.iterdir()} == left
        with whole_file(tmp_path / "other") as file:
            file.write_text("1")
        (tmp_path / "other").unlink()
        if number is None:
            assert {path.name for path in tmp_path.iterdir()} == left
            process.kill()
        process.stdout.close()
        process.wait()
        recover(tmp_path)
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("last", range(5))
@pytest.mark.parametrize("kind", ["folder", "folder and file", "files"])
def test_a_kill_between_two_renames_leaves_the_old_or_the_new_whole(tmp_path: Path, kind: str, last: int) -> None:
    (tmp_path / "out").mkdir()
    for name in ("out/mine", "run.csv", "run.yaml"):
        (tmp_path / name).write_text("old")
    subprocess.run([sys.executable, "-c", KILLED_BETWEEN, str(tmp_path), str(last), kind], check=False)
    recover(tmp_path, reading="run.csv")
    wanted = "new" if last > 0 else "old"
    ours = {"folder": ["out/mine"], "folder and file": ["out/mine", "run.csv"], "files": ["run.csv", "run.yaml"]}[kind]
    assert [(tmp_path / name).read_text() for name in ours] == [wanted] * len(ours)
    recover(tmp_path)
    assert names(tmp_path) == {"out/mine", "run.csv", "run.yaml"}
    assert [(tmp_path / name).read_text() for name in ours] == [wanted] * len(ours)


@pytest.mark.parametrize("kind", ["folder", "folder and file", "files"])
@pytest.mark.parametrize("call", ["replace", "rmdir", "unlink", "mkdir", "fsync"])
def test_a_call_that_fails_once_leaves_the_old_or_the_new_and_no_scratch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, call: str
) -> None:
    ours = {"folder": ["out/mine"], "folder and file": ["out/mine", "run.csv"], "files": ["run.csv", "run.yaml"]}[kind]
    original, number = getattr(os, call), 0
    monkeypatch.setattr(scratch, "exchange", lambda one, other: False)
    while True:
        for path in ("out/mine", "run.csv", "run.yaml"):
            (tmp_path / path).parent.mkdir(exist_ok=True)
            (tmp_path / path).write_text("old")
        calls: list[object] = []

        def failing(*arguments: object, at: int = number, calls: list[object] = calls, **named: object) -> object:
            calls.append(arguments)
            if len(calls) == at + 1:
                raise OSError(5, os.strerror(5))
            return original(*arguments, **named)

        with monkeypatch.context() as broken:
            broken.setattr(os, call, failing)
            try:
                if kind == "files":
                    with whole_file(tmp_path / "run.csv", overwrite=True) as file:
                        file.write_text("new")
                        file.with_suffix(".yaml").write_text("new")
                else:
                    with whole_folder(tmp_path / "out", writes=("mine",)) as folder:
                        (folder / "mine").write_text("new")
                        if kind == "folder and file":
                            (folder.parent / "run.csv").write_text("new")
            except (OSError, InputError):
                pass
        assert names(tmp_path) == {"out/mine", "run.csv", "run.yaml"}
        assert {path.name for path in tmp_path.iterdir()} == {"out", "run.csv", "run.yaml"}
        assert len({(tmp_path / name).read_text() for name in ours}) == 1
        if len(calls) <= number:
            break
        number += 1


def test_folders_of_other_users_are_not_published_in_a_common_folder(tmp_path: Path) -> None:
    if os.name == "nt" or os.geteuid() != 0:
        pytest.skip("only the superuser can make a folder of another user")
    hostile = tmp_path / f"{scratch.PUBLISHED}x"
    hostile.mkdir()
    (hostile / "mine").write_text("theirs")
    (tmp_path / "mine").write_text("ours")
    os.chown(hostile, 65534, 65534)
    with scratch.temporary_folder(tmp_path) as folder:
        assert folder.parent == tmp_path
    assert (tmp_path / "mine").read_text() == "ours"
    assert {path.name for path in tmp_path.iterdir()} == {"mine", hostile.name}


def test_a_folder_is_exchanged_in_one_step_where_the_system_can(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "is").write_text(name)
    if not scratch.exchange(tmp_path / "a", tmp_path / "b"):
        pytest.skip("this disk or system exchanges no names")
    assert [(tmp_path / name / "is").read_text() for name in "ab"] == ["b", "a"]


def test_a_reader_waits_for_a_living_process_that_publishes(tmp_path: Path) -> None:
    publishing = tmp_path / f"{scratch.PUBLISHED}x"
    publishing.mkdir()
    (publishing / "run.csv").write_text("new")
    lock = scratch.lock_of(publishing)
    assert lock is not None
    began = time.monotonic()
    scratch.LONGEST_WAIT_S, before = 0.2, scratch.LONGEST_WAIT_S
    try:
        recover(tmp_path, reading="run.csv")
    finally:
        scratch.LONGEST_WAIT_S = before
    assert 0.2 <= time.monotonic() - began < 5.0
    assert not (tmp_path / "run.csv").exists()
    os.close(lock)
    recover(tmp_path, reading="run.csv")
    assert (tmp_path / "run.csv").read_text() == "new"


def test_a_result_replaces_another_result_alone(tmp_path: Path) -> None:
    write_result(tmp_path / "a.json", {"schema": "rlgcomp.x/1"})
    write_result(tmp_path / "a.json", {"schema": "rlgcomp.x/1", "more": 1})
    for text in ("{}", '{"schema": "other"}', "no json", "[1]"):
        (tmp_path / "a.json").write_text(text)
        with pytest.raises(InputError, match="rlgcomp did not write it"):
            write_result(tmp_path / "a.json", {"schema": "rlgcomp.x/1"})
        assert (tmp_path / "a.json").read_text() == text
    write_result(tmp_path / "a.json", {"schema": "rlgcomp.x/1"}, overwrite=True)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="no plain file"):
        write_result(tmp_path / "pipe", {"schema": "rlgcomp.x/1"}, overwrite=True)


def test_a_full_disk_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with whole_folder(tmp_path / "out", writes=("mine",)) as folder:
        (folder / "mine").write_text("old")

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    def work() -> None:
        with whole_folder(tmp_path / "out", writes=("mine",)) as folder:
            (folder / "mine").write_text("new")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        work()
    assert names(tmp_path) == {"out/mine"}
    assert (tmp_path / "out" / "mine").read_text() == "old"


def test_what_a_kill_left_half_published_may_be_replaced(tmp_path: Path) -> None:
    """Of two files that belong together one has its place, the other is still in the published folder."""
    (tmp_path / "run.csv").write_text("new")
    (tmp_path / "run.yaml").write_text("earlier")
    rest = tmp_path / f"{scratch.PUBLISHED}x"
    rest.mkdir()
    (rest / "run.yaml").write_text("new")
    require_replaceable(tmp_path / "run.csv", overwrite=False, written=lambda path: path.with_suffix(".yaml").read_text() == "new")
    assert not rest.exists()
    assert (tmp_path / "run.yaml").read_text() == "new"


def test_scratch_in_a_folder_that_is_to_be_replaced_is_not_foreign(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "result.json").write_text("{}")
    left = folder / f"{scratch.PREFIX}dead"
    left.mkdir()
    require_folder(folder, writes=("result.json",))
    assert not left.exists()
    (folder / "mine.txt").write_text("x")
    with pytest.raises(InputError, match=r"holds mine\.txt, which an earlier run did not write"):
        require_folder(folder, writes=("result.json",))


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no names of open files here")
def test_what_is_written_within_scratch_is_flushed_once_before_the_whole_takes_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[str] = []
    fsync, place = os.fsync, tmp_path / "out"

    def recorded(handle: int) -> None:
        flushed.append(f"{Path(f'/proc/self/fd/{handle}').resolve().name} {place.exists()}")
        fsync(handle)

    monkeypatch.setattr(os, "fsync", recorded)
    with whole_folder(place, writes=("mine",)) as folder:
        with whole_folder(folder / "inner", writes=("theirs",)) as inner:
            (inner / "theirs").write_text("new")
            (inner.parent / "beside").write_text("new")
        write_text(folder / "mine", "new")
    assert names(place) == {"inner/theirs", "beside", "mine"}
    assert sorted(flushed[:-1]) == ["beside False", "inner False", "mine False", "out False", "theirs False"]
    assert flushed[-1] == f"{tmp_path.name} True"
