"""Shared fixtures: simulated runs made once, and the recordings kept outside the project, where they are."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

import rlgcomp as rlg
from tests.cluster import Cluster

ROOT = Path(__file__).resolve().parent.parent

# The same examples at every run, so that a change is judged by what it changed; --hypothesis-profile=search looks for new ones.
# How long an example takes says more of the machine than of the project.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None)
settings.load_profile("same")


def pytest_collection_finish() -> None:
    """Thousands of tests and the modules that they import stay until the end; collections of garbage look at them seldom."""
    gc.set_threshold(100_000, 20, 50)  # not gc.freeze: the lowest version of Hypothesis takes what is frozen for lost


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
    """A real scheduler and two worker processes."""
    pytest.importorskip("distributed")
    place = tmp_path / "scheduler.json"
    log = (tmp_path / "log").open("wb")
    paths = os.pathsep.join([str(Path(rlg.__file__).parents[1]), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    settings = {**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-m", *arguments], stdout=log, stderr=log, env=settings, cwd=tmp_path)

    options = ["--scheduler-file", str(place), "--no-dashboard"]
    processes = [start("distributed.cli.dask_scheduler", *options, "--host", "127.0.0.1", "--port", "0")]
    try:
        for _ in range(200):
            if place.exists():
                break
            time.sleep(0.1)
        worker = ["distributed.cli.dask_worker", *options, "--nthreads", "1", "--no-nanny"]
        processes += [start(*worker), start(*worker)]
        yield json.loads(place.read_text())["address"], processes
    finally:
        for process in processes:
            process.kill()
            process.wait()
        log.close()
