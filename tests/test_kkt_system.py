"""The KKT system on a torch device: against the processor, what is saved, and errors where it cannot be computed."""

from __future__ import annotations

import gc
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import compensation, register_commands
from rlgcomp.cli.base import app
from rlgcomp.compensation.models import kkt_system
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.kkt_system import DeviceKKTSystem, device_named

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.needs("torch")
register_commands()
KERNELS = [{"kernel": "gaussian", "sigma": 2.0}, {"kernel": "linear"}, {"kernel": "polynomial", "degree": 2}]


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(600, 5))
    y = np.sin(X[:, 0]) + 0.3 * X[:, 1] ** 2 + 0.1 * rng.normal(size=600)
    y[::50] += 3.0
    return X, y


def close(computed: Any, expected: Any) -> None:
    assert np.abs(np.asarray(computed) - expected).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("width", [100, 384, 1000], ids=["six panels", "two, the last one short", "one"])
@pytest.mark.parametrize("robust", [False, True], ids=["plain", "robust"])
@pytest.mark.parametrize("parameters", KERNELS, ids=lambda parameters: parameters["kernel"])
def test_it_is_the_system_of_the_processor(
    data: tuple[np.ndarray, np.ndarray], parameters: dict[str, Any], robust: bool, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(kkt_system.PANEL_WIDTH, "cpu", width)
    monkeypatch.setattr(kkt_system, "BATCH", 600 * 7)
    plain = rlg.LSSVMRegressor(c=50.0, robust=robust, **parameters).fit(*data)
    on_device = rlg.LSSVMRegressor(c=50.0, robust=robust, device="cpu", **parameters).fit(*data)
    for name in ("alpha_", "intercept_", "weights_", "loo_residuals_", "scale_"):
        close(getattr(on_device, name), getattr(plain, name))
        assert type(getattr(on_device, name)) is type(getattr(plain, name))
    at = np.random.default_rng(1).normal(size=(33, 5))
    for computed, expected in zip(on_device.predict(at, return_std=True), plain.predict(at, return_std=True), strict=True):
        close(computed, expected)
    for groups in (np.arange(600) // 150, np.arange(600) % 7, np.arange(600) > 400):
        close(on_device.leave_groups_out(groups), plain.leave_groups_out(groups))


def test_integers_and_what_is_read_only_or_reversed_are_taken(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = np.round(4.0 * data[0]).astype(int), np.round(9.0 * data[1]).astype(int)
    expected = rlg.LSSVMRegressor(device="cpu").fit(X.astype(float), y.astype(float)).predict(X.astype(float))
    reverse = X[::-1][::-1], y[::-1][::-1]
    for values in reverse:
        values.setflags(write=False)
    assert np.array_equal(rlg.LSSVMRegressor(device="cpu").fit(*reverse).predict(reverse[0]), expected)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(2, 60), st.integers(1, 70), st.floats(0.1, 1e3))
def test_it_solves_the_kkt_system_whatever_the_panels(seed: int, n: int, width: int, c: float) -> None:
    rng = np.random.default_rng(seed)
    X, y, weights = rng.normal(size=(n, 2)), rng.normal(size=n), c * rng.uniform(0.1, 1.0, size=n)
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(kkt_system.PANEL_WIDTH, "cpu", width)
        system = DeviceKKTSystem("gaussian", {"sigma": 1.0}, X, "cpu", weights)
        alpha, intercept = system.solve(y)
        diagonal = system.inverse_diagonal()
    kkt_matrix = np.ones((n + 1, n + 1))
    kkt_matrix[0, 0] = 0.0
    kkt_matrix[1:, 1:] = kernel("gaussian", {"sigma": 1.0}, X, X) + np.diag(1.0 / weights)
    inverse = np.linalg.inv(kkt_matrix)
    assert np.r_[intercept, alpha] == pytest.approx(inverse[:, 1:] @ y, abs=1e-9 * c)
    assert diagonal == pytest.approx(np.diag(inverse)[1:], abs=1e-9 * c)


def test_it_stores_half_a_matrix(data: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(kkt_system.PANEL_WIDTH, "cpu", 60)
    before = bytes_of_tensors()
    system = DeviceKKTSystem("gaussian", {"sigma": 2.0}, data[0], "cpu", np.ones(600))
    vectors = 8 * 600 * (5 + 1)  # the inputs, and a solution
    assert bytes_of_tensors() - before == 8 * 600 * (600 + 60) // 2 + vectors
    assert len(system.inverse_diagonal()) == 600  # it was there until now


def bytes_of_tensors() -> int:
    """Of the tensors that live, each storage once."""
    gc.collect()
    storages = [each.untyped_storage() for each in gc.get_objects() if type(each) is torch.Tensor]
    return sum({storage.data_ptr(): storage.nbytes() for storage in storages}.values())


def test_a_pickled_model_is_plain_numbers(data: tuple[np.ndarray, np.ndarray]) -> None:
    model = rlg.LSSVMRegressor(device="cpu").fit(*data)
    pickled = pickle.dumps(model)
    assert b"torch" not in pickled
    assert np.array_equal(pickle.loads(pickled).predict(data[0]), model.predict(data[0]))  # noqa: S301


def test_what_is_saved_knows_no_device(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    """An artefact from a card is read where there is none, and predicts the same."""
    on_device, plain = (
        rlg.Compensator(rlg.LSSVMRegressor(device=name, run_variance=0.0), features="temperature").fit(short_runs[:2])
        for name in ("cpu", None)
    )
    on_device.save(tmp_path / "model")
    assert "device" not in (tmp_path / "model" / "manifest.json").read_text()
    loaded = rlg.load(tmp_path / "model")
    assert loaded.model_.device is None
    for column in ("bias_deg_h", "half_width_deg_h"):
        expected = plain.predict(short_runs[2])[column].to_numpy()
        assert loaded.predict(short_runs[2])[column].to_numpy() == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_torch_is_imported_only_when_used() -> None:
    code = (
        "import sys, numpy as np, rlgcomp as rlg; m = rlg.LSSVMRegressor().fit(np.eye(5), np.arange(5.0)); "
        "m.predict(np.eye(5), return_std=True); m.leave_groups_out(np.arange(5)); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", ["gpu", "", "mps", "meta", "cuda:", 0, True, "cpu "])
def test_names_of_no_device_are_refused(data: tuple[np.ndarray, np.ndarray], name: Any) -> None:
    with pytest.raises(rlg.InputError, match=r"'device' parameter of LSSVMRegressor must be .* Got .* instead"):
        rlg.LSSVMRegressor(device=name).fit(*data)


def test_a_device_that_is_missing_is_refused(data: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(rlg.InputError, match=r"device='cuda:999' is not available .* give 'cpu', or leave it out"):
        rlg.LSSVMRegressor(device="cuda:999").fit(*data)
    assert device_named("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")


def test_without_torch_the_error_names_the_extra(data: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(rlg.InputError, match="needs torch, which is not installed; pip install"):
        rlg.LSSVMRegressor(device="cpu").fit(*data)


@pytest.mark.parametrize("error", ["CUDA out of memory. Tried to allocate 37 GiB", "DefaultCPUAllocator: can't allocate memory"])
def test_too_many_rows_for_its_memory_are_refused(
    data: tuple[np.ndarray, np.ndarray], error: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise RuntimeError(error)

    monkeypatch.setattr(torch.linalg, "cholesky_ex", full)
    with pytest.raises(rlg.InputError, match="600 rows do not fit into the memory of cpu"):
        rlg.LSSVMRegressor(device="cpu").fit(*data)
    error = "an illegal memory access was encountered"
    with pytest.raises(RuntimeError, match="illegal"):
        rlg.LSSVMRegressor(device="cpu").fit(*data)


def test_an_indefinite_kernel_is_refused(data: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(rlg.InputError, match="sigmoid kernel's matrix is not positive definite"):
        rlg.LSSVMRegressor("sigmoid", c=1e6, slope=1.0, offset=-1.0, device="cpu").fit(*data)


@pytest.fixture
def run_files(short_runs: list[rlg.Recording], tmp_path: Path) -> list[str]:
    paths = [tmp_path / f"{k}.parquet" for k in range(2)]
    for path, run in zip(paths, short_runs, strict=False):
        rlg.write(run, path)
    return [str(path) for path in paths]


@pytest.mark.parametrize(("device", "rows", "warned"), [("cpu", 50, True), ("auto", 5000, False), (None, 50, False)])
def test_the_command_trains_on_it_and_warns_of_a_long_fit(
    run_files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: str | None, rows: int, warned: bool
) -> None:
    monkeypatch.setattr(compensation, "MANY_ROWS", rows)
    options = ["train", *run_files, "--features", "temperature", "--out", str(tmp_path / "model")]
    done = CliRunner().invoke(app, options + ([] if device is None else ["--device", device]))
    assert done.exit_code == 0, done.output
    assert ("rows are fitted on the processor" in " ".join(done.output.split())) is warned
    assert rlg.load(tmp_path / "model").model_.device is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--device", "gpu"], "'device' parameter"),
        (["--device", "cuda:999"], "is not available"),
        (["--device", "cpu", "--model", "cubic"], "--device is for --model lssvm alone"),
    ],
)
def test_the_command_refuses_with_one_message(run_files: list[str], tmp_path: Path, options: list[str], message: str) -> None:
    done = CliRunner().invoke(app, ["train", *run_files, "--out", str(tmp_path / "model"), *options])
    assert done.exit_code == 2
    assert sum(line.startswith("error:") for line in done.output.splitlines()) == 1  # torch may say "error:" inside the reason
    assert message in " ".join(done.output.split())
    assert not (tmp_path / "model").exists()
