"""The second process: answers, what it cannot do, and how it ends."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time

import pytest

from rlgcomp.beside import Beside, beside


def refused(value: int) -> int:
    raise ValueError(f"{value} is refused")


def test_functions_are_called_in_the_other_process_and_in_order() -> None:
    with Beside("math") as other:
        futures = [other.submit(math.hypot, 3.0, k) for k in range(5)]
        theirs = other.submit(os.getpid).result()
        assert [future.result() for future in futures] == [math.hypot(3.0, k) for k in range(5)]
        assert theirs != os.getpid()
        assert other.submit(json.dumps, {"a": 1}, indent=1).result() == '{\n "a": 1\n}'


def test_what_cannot_be_done_there_is_done_here() -> None:
    with Beside() as other:
        assert other.submit(lambda: [os.getpid()]).result() == [os.getpid()]  # a function without a name has no way there
        with pytest.raises(ValueError, match="3 is refused"):
            other.submit(refused, 3).result()
        assert other.submit(os.getpid).result() != os.getpid()  # and it goes on
    with Beside("there_is_no_such_module") as other:
        assert other.submit(os.getpid).result() == os.getpid()


def test_an_error_does_not_wait_for_what_it_does() -> None:
    other = Beside()
    futures = [other.submit(time.sleep, 600.0) for _ in range(2)]
    while not futures[0].running():
        time.sleep(0.01)
    other.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert all(future.done() for future in futures)


def test_what_is_printed_there_is_no_answer(capfd: pytest.CaptureFixture[str]) -> None:
    with Beside() as other:
        assert other.submit(print, "aside", flush=True).result() is None
    assert capfd.readouterr().out == ""


def test_one_core_has_no_second_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    with beside() as other:
        assert other is None


def test_it_starts_without_the_main_script(tmp_path: object) -> None:
    script = "from rlgcomp.beside import Beside\nimport os\nprint('once')\nwith Beside() as b: print(b.submit(os.getcwd).result())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=str(tmp_path))
    assert done.stdout.splitlines() == ["once", str(tmp_path)]
