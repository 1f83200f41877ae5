"""Shared fixtures: simulated runs made once, and the recordings kept outside the project, where they are."""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported: workers share the cores, and threads that wait spin

import pytest
import typer.main
from hypothesis import settings

import rlgcomp as rlg
from experiments.cluster import Cluster, local_cluster

ROOT = Path(__file__).resolve().parent.parent

# The same examples at every run, so that a change is judged by what it changed; --hypothesis-profile=search looks for new ones.
# How long an example takes says more of the machine than of the project.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None)
settings.load_profile("same")


_BUILT: dict[int, tuple[object, object]] = {}


def built_once(command_info: object, *, build: Callable[..., object] = typer.main.get_command_from_info, **how: object) -> object:
    """A command of the application: Typer builds all of them anew for each that a test runs, which takes 0.1 s each time."""
    if id(command_info) not in _BUILT:
        _BUILT[id(command_info)] = command_info, build(command_info, **how)
    return _BUILT[id(command_info)][1]


typer.main.get_command_from_info = built_once


def pytest_collection_finish() -> None:
    """Thousands of tests and the modules that they import stay until the end; collections of garbage look at them seldom."""
    gc.set_threshold(100_000, 20, 50)  # not gc.freeze: the lowest version of Hypothesis takes what is frozen for lost


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A test marked `needs` is skipped where one of its libraries is absent; `-m needs` selects these alone."""
    for mark in item.iter_markers("needs"):
        for library in mark.args:
            pytest.importorskip(library)


def pytest_runtest_teardown() -> None:
    """Experiments silence the remarks of their process; the next test hears them."""
    logging.disable(logging.NOTSET)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of pages are made and not drawn: for tests that look at a page's text, or at its files, alone."""
    monkeypatch.setattr("rlgcomp.report.svg.svg", lambda *_: "<svg></svg>")


@pytest.fixture(scope="session")
def unit() -> rlg.Simulator:
    return rlg.simulated_unit(1)


@pytest.fixture(scope="session")
def short_runs(unit: rlg.Simulator) -> list[rlg.Recording]:
    """Three short chamber runs of one gyro, sampled every 5 s."""
    return [unit.simulate("short", seed=seed, step_s=5.0, name=f"short-{seed}") for seed in (1, 2, 3)]


@pytest.fixture(scope="session")
def trained(short_runs: list[rlg.Recording]) -> rlg.Compensator:
    return rlg.Compensator(rlg.LSSVMRegressor()).fit(short_runs[:2])


@pytest.fixture
def shared() -> Path:
    """Folder of recordings beside the project; tests that need it are skipped where it is absent."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no shared recordings beside the project (../shared/data)")
    return folder


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A real scheduler and three worker processes."""
    with local_cluster(3, tmp_path) as started:
        yield started
