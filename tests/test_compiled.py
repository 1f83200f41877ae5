"""Compiled loops: the same bits as plain Python where that is promised, rounding elsewhere; threads, and life without Numba."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import threadpoolctl

from rlgcomp.errors import InputError
from rlgcomp.numerics import bouc_wen_loops, compiled, filters, hysteresis_loops
from rlgcomp.numerics.hysteresis import BoucWen, Play, play_paths
from rlgcomp.physics.mode_hop import ModeHop
from rlgcomp.recording import Recording

needs_numba = pytest.mark.skipif(not compiled.available(), reason="Numba is not installed, or switched off")
RADII = np.linspace(0.0, 12.0, 7)
WEIGHTS = np.random.default_rng(1).normal(size=7)


@pytest.fixture(autouse=True)
def _few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hysteresis_loops, "MANY", 50)
    monkeypatch.setattr(bouc_wen_loops, "BOUC_WEN_PIECE", 3)
    monkeypatch.setattr(hysteresis_loops, "PLAY_PIECE", 3)
    monkeypatch.setattr(hysteresis_loops, "LARGE", 50)


def inputs(n: int = 301, gyros: int = 7) -> np.ndarray:
    rng = np.random.default_rng(2)
    slow = 10.0 * np.sin(np.linspace(0.0, 12.0, n))[:, None] * rng.uniform(0.5, 1.5, gyros)
    return slow + 0.02 * rng.normal(size=(n, gyros)) + np.where(rng.uniform(size=(n, gyros)) < 0.01, 5.0, 0.0)


def plainly(function: object, *arguments: object) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLGCOMP_NUMBA", "0")
        return function(*arguments)


@needs_numba
def test_play_states_have_the_same_bits() -> None:
    u = inputs()
    for inputs_of in (u[:, :1], u):
        start = inputs_of[0] + np.zeros(7)
        assert np.array_equal(play_paths(inputs_of, RADII, start), plainly(play_paths, inputs_of, RADII, start))
    play = Play((0.5, 2.0))
    fast, slow = play.run(play.init(u[0, 0]), u[:, 0]), plainly(play.run, play.init(u[0, 0]), u[:, 0])
    assert np.array_equal(fast[0], slow[0])
    assert np.array_equal(fast[1], slow[1])


@needs_numba
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
def test_bouc_wen_has_the_same_bits_alone_in_a_fleet_and_without_numba(exponent: float) -> None:
    u = inputs()
    operator = BoucWen(1.0, 6.0, 0.8, exponent)
    plain = np.column_stack([plainly(operator.run, operator.init(x[0]), x)[0] for x in u.T])
    alone = np.column_stack([operator.run(operator.init(x[0]), x)[0] for x in u.T])
    assert np.array_equal(alone, plain)
    assert np.array_equal(bouc_wen_loops.bouc_wen_fleet(u, 1.0, 6.0, 0.8, exponent), plain)
    assert np.array_equal(plainly(bouc_wen_loops.bouc_wen_fleet, u, 1.0, 6.0, 0.8, exponent), plain)


@needs_numba
@pytest.mark.parametrize("start", ["rested", "from_below", "from_above"])
def test_hops_of_modes_are_the_same_bits(start: str) -> None:
    temperature = inputs()[:, 0]  # begins between the levels of the second hop
    recording = Recording(pd.DataFrame({"time_s": np.arange(301.0), "gyro_deg_h": 0.0, "temperature_degC": temperature}))
    hops = ModeHop(threshold_degC=-4.0, dead_band_K=3.0, spacing_K=5.0, hops=2, start=start)
    import numba  # noqa: F401 - from then on it is compiled

    fast = hops.basis(recording)
    assert np.array_equal(fast, plainly(hops.basis, recording))
    assert set(np.unique(fast)) == {0.0, 1.0, 2.0}
    assert fast[0, 0] == (1.0 if start == "from_below" else 2.0)  # at rest above the middle of the two levels


@needs_numba
@pytest.mark.parametrize("n", [9, 300, 301, 302, 303])
def test_sums_of_plays_are_weighted_states(n: int) -> None:
    u = inputs(n)
    states = np.stack([plainly(play_paths, x[:, None], RADII, np.full(7, x[0])) for x in u.T])
    expected = np.einsum("gnj,j->ng", states, WEIGHTS)
    fleet = hysteresis_loops.play_sums(u, RADII, WEIGHTS, np.tile(u[0], (7, 1)))
    np.testing.assert_allclose(fleet, expected, atol=1e-12)
    np.testing.assert_allclose(plainly(hysteresis_loops.play_sums, u, RADII, WEIGHTS, np.tile(u[0], (7, 1))), expected, atol=1e-12)
    for g in range(2):
        one = hysteresis_loops.play_sums(u[:, g], RADII, WEIGHTS, np.full(7, u[0, g]))
        np.testing.assert_allclose(one, expected[:, g], atol=1e-12)


def test_shapes_that_do_not_fit_are_refused() -> None:
    u = inputs()
    for bad in (
        (u, RADII, WEIGHTS[:3], np.zeros((7, 7))),
        (u, RADII, WEIGHTS, np.zeros(7)),
        (u[:, 0], RADII, WEIGHTS, np.zeros(6)),
    ):
        with pytest.raises(InputError, match="as many weights as radii"):
            hysteresis_loops.play_sums(*bad)


def test_threads_are_those_that_joblib_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    everything = compiled.threads()
    assert everything >= 1
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    assert compiled.threads() == 1
    monkeypatch.setenv("NUMBA_NUM_THREADS", "4096")
    assert compiled.threads() == everything


def test_a_fault_in_a_thread_is_not_lost() -> None:
    def fails(value: int) -> None:
        raise ZeroDivisionError(value)

    with pytest.raises(ZeroDivisionError):
        compiled.in_threads(fails, [(1,), (2,)], 2)


def test_short_work_does_not_wait_for_numba() -> None:
    code = (
        "import numpy as np, sys; from rlgcomp.numerics.hysteresis import BoucWen\n"
        "from rlgcomp.noise.allan_deviation import allan_deviation\n"
        "u = np.linspace(0.0, 1.0, 500); b = BoucWen(); b.run(b.init(0.0), u)\n"
        "allan_deviation(np.sin(u * 99.0), np.arange(500.0)); print('numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@needs_numba
def test_the_low_pass_has_the_same_bits_in_a_stream_and_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    values, step_s = np.cumsum(rng.normal(size=500)), np.r_[0.0, rng.uniform(0.5, 1.5, 499)]
    plain, last = filters.low_pass(1.0, values, step_s, 7.0)
    monkeypatch.setattr(filters, "MANY", 1)
    fast, end = filters.low_pass(1.0, values, step_s, 7.0)
    assert np.array_equal(fast, plain)
    assert end == last
    first, middle = filters.low_pass(1.0, values[:200], step_s[:200], 7.0)
    assert np.array_equal(np.r_[first, filters.low_pass(middle, values[200:], step_s[200:], 7.0)[0]], plain)


def test_linear_algebra_has_the_threads_it_is_given_and_gets_its_own_back() -> None:
    def now() -> list[int]:
        return [library["num_threads"] for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas"]

    before = now()
    with compiled.blas_threads(2):
        assert set(now()) == {2}
        with compiled.blas_threads(1):
            assert set(now()) == {1}
        assert set(now()) == {2}
    assert now() == before


def test_libraries_are_looked_for_again_only_when_modules_were_imported_since(monkeypatch: pytest.MonkeyPatch) -> None:
    looked, controller = [], threadpoolctl.ThreadpoolController
    monkeypatch.setattr(threadpoolctl, "ThreadpoolController", lambda: looked.append(0) or controller())
    for name, times in (("one_library", 1), ("one_library", 1), ("another_library", 2)):
        monkeypatch.setitem(sys.modules, name, sys)
        with compiled.blas_threads(1):
            assert len(looked) == times


_EACH_ANEW = """
import json, os, resource, signal, sys
import numba
import numpy as np
from rlgcomp.numerics import filters
filters.MANY = 1
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for line in sys.stdin:
    process = os.fork()
    if process == 0:
        environment = json.loads(line)
        if environment.pop("full", False):
            resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))
        os.environ.update(environment)
        print(repr(float(filters.low_pass(0.0, np.sin(np.arange(500.0)), np.ones(500), 7.0)[0].sum())), flush=True)
        os._exit(0)
    if os.waitpid(process, 0)[1]:
        print("nan", flush=True)
"""  # one short loop, soon compiled


@pytest.fixture(scope="module")
def anew() -> Iterator[Callable[..., str]]:
    """Compile the loop in a new process with an environment of its own, and use it: each is forked from one that has Numba."""
    unset = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    line = [sys.executable, "-c", _EACH_ANEW]
    with subprocess.Popen(
        line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=unset
    ) as made:
        assert made.stdin is not None
        assert made.stdout is not None
        asked, answers = made.stdin, made.stdout

        def use(**environment: object) -> str:
            print(json.dumps(environment), file=asked, flush=True)
            return answers.readline()

        yield use
        _, errors = made.communicate()
        assert (made.returncode, errors) == (0, "")


@needs_numba
def test_compiled_code_is_kept_in_the_users_cache_and_never_in_the_package(
    anew: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it is damaged, that costs speed alone."""
    monkeypatch.setattr(filters, "MANY", 1)
    result = float(filters.low_pass(0.0, np.sin(np.arange(500.0)), np.ones(500), 7.0)[0].sum())
    package = Path(compiled.__file__).parents[1]
    before = set(package.rglob("*.nb?"))
    assert float(anew(XDG_CACHE_HOME=str(tmp_path))) == result
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "rlgcomp").rglob("*.nb?")}
    assert kept
    assert float(anew(XDG_CACHE_HOME=str(tmp_path))) == result
    assert {path: path.stat().st_mtime_ns for path in kept} == kept  # the second process compiled nothing
    assert set(package.rglob("*.nb?")) == before
    for path in kept:
        path.write_bytes(path.read_bytes()[:40])
    assert float(anew(XDG_CACHE_HOME=str(tmp_path))) == result


_LOOP = """
from rlgcomp.numerics.compiled import compiled

STEP = {step}


def further(value):
    return value + STEP{more}


@compiled()
def loop(value):
    return further(value)
"""
_USE = "import sys; sys.path.insert(0, {folder!r}); import loops; print(loops.loop(1.0))"


@needs_numba
def test_another_installation_compiles_nothing_that_says_the_same(tmp_path: Path) -> None:
    """A loop that reads another number, or calls another function of its module, says something else."""

    def used(folder: str, step: float, more: str = "", above: str = "") -> tuple[str, int]:
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "loops.py").write_text(above + _LOOP.format(step=step, more=more))
        line, environment = [sys.executable, "-B", "-c", _USE.format(folder=str(tmp_path / folder))], dict(os.environ)
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
        done = subprocess.run(line, capture_output=True, text=True, check=True, env=environment)
        return done.stdout.strip(), len(list((tmp_path / "cache").rglob("*.nbc")))

    answer, kept = used("one", 1.0)
    assert answer == "2.0"
    assert kept
    assert used("two", 1.0, above="# another line\n") == ("2.0", kept)
    answer, more = used("two", 2.0)
    assert answer == "3.0"
    assert more > kept
    answer, most = used("two", 2.0, more=" + STEP")
    assert answer == "5.0"
    assert most > more


@needs_numba
def test_a_cache_that_cannot_be_written_costs_speed_alone(
    anew: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its folder is a file, or there is none at home, or no file may grow: what is compiled cannot be kept."""
    monkeypatch.setattr(filters, "MANY", 1)
    result = float(filters.low_pass(0.0, np.sin(np.arange(500.0)), np.ones(500), 7.0)[0].sum())
    (tmp_path / "file").write_text("no folder")
    for environment in ({"XDG_CACHE_HOME": str(tmp_path / "file")}, {"HOME": "/dev/null"}):
        assert float(anew(**environment)) == result
    assert float(anew(XDG_CACHE_HOME=str(tmp_path / "full"), full=True)) == result
    assert not sum(path.stat().st_size for path in tmp_path.rglob("*.nbc"))
