"""The compensator: features, scaling, model and range guard, from recordings to corrected recordings."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
from sklearn.base import BaseEstimator, clone

from rlgcomp.compensation import serialisation
from rlgcomp.compensation.artefact import SCHEMA
from rlgcomp.compensation.correction import require_distinct, require_raw
from rlgcomp.compensation.feature_pipeline import (
    FeatureRecipe,
    feature_names,
    further_monitors,
    nearly_standard,
    omitted_groups,
    pipeline_for,
    require_no_gyro,
)
from rlgcomp.compensation.features import Level
from rlgcomp.compensation.held_out_errors import HeldOutErrors
from rlgcomp.compensation.input_selection import ChosenInputs
from rlgcomp.compensation.interval import Interval, require_turn_on
from rlgcomp.compensation.known_physics import HybridInputs, amplitudes_of, on_amplitudes, on_gain, parts_of, require_lssvm
from rlgcomp.compensation.models import DEFAULT, MODELS, specification_of
from rlgcomp.compensation.models.cubic import DYNAMICS
from rlgcomp.compensation.models.lssvm import LSSVMRegressor
from rlgcomp.compensation.models.lssvm_search import MANY_ROWS
from rlgcomp.compensation.models.specification import grouping, require_regressor
from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.compensation.prediction import Prediction
from rlgcomp.compensation.selection import Progress, Selection, select
from rlgcomp.compensation.training_remarks import (
    on_constant_inputs,
    on_errors_below_noise,
    on_interval,
    on_leading_thermometer,
    on_selection,
    on_turning,
    warn_of_earth_rate,
)
from rlgcomp.compensation.untold_inputs import UntoldInputs
from rlgcomp.compensation.window_means import BLOCKS_OF_ONE_RUN, Scaling, require_averaging, run_labels, scaled_rows, window_means
from rlgcomp.errors import InputError
from rlgcomp.recording import DEFAULT_AVERAGING_S, Recording
from rlgcomp.recording.argument_checks import require_recordings, require_workers
from rlgcomp.recording.outliers import without_outliers
from rlgcomp.report.messages import Message
from rlgcomp.report.notebook import table_html
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)


class Compensator(Prediction, BaseEstimator):  # type: ignore[misc]
    """Bias compensation of one gyro.

    Parameters
    ----------
    model : estimator, optional
        A scikit-learn regressor, which is not changed. By default a :class:`~rlgcomp.LSSVMRegressor` in which every input enters
        linearly, and those that are no history of temperature by the kernel as well; with `physics` the kernel takes all inputs.
    features : str or sequence of str
        "all", groups such as "temperature,temperature_rate", or further columns; see
        :func:`rlgcomp.compensation.feature_pipeline.pipeline_for`.
    averaging_s : float
        The model is trained on means over this time.
    gyro : str, optional
        Gyro column, where there are several.
    keep_mean : bool
        Remove only how the bias differs from its mean over training: for runs whose gyro still holds Earth rate.
    n_jobs : int
        Worker processes of the selection; -1 for every core.
    physics : Simulator, optional
        Of a chamber, as ``diagnosis.augmented``: its mechanisms are the mean, their amplitudes fitted with the LS-SVM, which learns
        the rest; see :mod:`rlgcomp.compensation.known_physics`. Beyond the training range the physics goes on, and the LS-SVM's
        part keeps its value at the edge.
    turn_on_deg_h : float, optional
        Repeatability of the bias from switch-on to switch-on, one standard deviation, as a data sheet states it: for the interval
        of models trained on few runs. With one run, the standard deviation of its bias is assumed unless it is stated.

    Attributes
    ----------
    specification_ : ModelSpecification or None
        How the model is selected and saved; None for a regressor of the user's own.
    pipeline_ : FeatureRecipe
    scaling_ : Scaling
    model_ : estimator
        Fitted with the selected parameters.
    selection_ : Selection
    interval_ : Interval
        How far the truth may be from the estimate, calibrated on runs left out.
    training_ : tuple of WindowMeans
        The training runs.
    unused_ : dict of str to float
        Monitors that "all" did not use, and the relative change in mean square error over runs left out that each would bring.
    untold_ : UntoldInputs
        Inputs that "all" could not tell apart, with their ranges.
    provenance_ : list of dict
        Metadata of the training runs.
    remarks_ : tuple of Message
        On the training runs, and on a model that gains nothing with runs left out.
    schema_ : str
        Of the artefact that it was read from, or would be saved to.

    Examples
    --------
    >>> import rlgcomp as rlg
    >>> runs = [rlg.simulated_unit(1).simulate("short", seed=seed) for seed in (1, 2)]
    >>> model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(runs)
    >>> model.correct(runs[0]).columns[:4]
    ('time_s', 'gyro_deg_h', 'compensation_deg_h', 'compensation_out_of_range')
    """

    def __init__(
        self,
        model: Any = None,
        *,
        features: str | Sequence[str] = "all",
        averaging_s: float = DEFAULT_AVERAGING_S,
        gyro: str | None = None,
        keep_mean: bool = False,
        n_jobs: int = 1,
        physics: Simulator | None = None,
        turn_on_deg_h: float | None = None,
    ) -> None:
        self.model = model
        self.features = features
        self.averaging_s = averaging_s
        self.gyro = gyro
        self.keep_mean = keep_mean
        self.n_jobs = n_jobs
        self.physics = physics
        self.turn_on_deg_h = turn_on_deg_h

    def _repr_html_(self) -> str:
        heading, _, rest = repr(self).partition("\n")
        return table_html(heading, pd.DataFrame(), rest.splitlines())

    def _repr_mimebundle_(self, **options: Any) -> dict[str, str]:
        """As other results; scikit-learn's diagram of an estimator would show parameters alone."""
        return {"text/plain": repr(self), "text/html": self._repr_html_()}

    def __repr__(self) -> str:
        if hasattr(self, "model_"):
            return serialisation.summary(serialisation.manifest_of(self))
        model = "LSSVMRegressor" if self.model is None else type(self.model).__name__
        features = self.features if isinstance(self.features, str) else ", ".join(map(str, self.features))
        return f"Compensator, not fitted: {model}, features {features}, {self.averaging_s:g} s means"

    # --- training ----------------------------------------------------------------------------------------------------------

    def fit(
        self,
        runs: Iterable[Recording],
        *,
        journal: Path | None = None,
        progress: Progress | None = None,
        screen: bool = True,
    ) -> Self:
        """Select parameters by leaving runs out, then fit on all of them.

        Parameters
        ----------
        runs : iterable of Recording
            With a single run, [run], five contiguous blocks take the place of runs.
        journal : path, optional
            File of finished work, from which an interrupted selection resumes; see :mod:`rlgcomp.compensation.selection`.
        progress : callable, optional
            Called with (done, total).
        screen : bool
            Leave out the outliers that :mod:`rlgcomp.recording.outliers` detects; not needed for runs without them.

        Raises
        ------
        InputError
            A run is given twice, was compensated already, is too short, lacks a monitor, or has several gyros; the model is no
            regressor; or a parameter is out of bounds.
        """
        runs, workers = require_recordings(runs, "runs"), require_workers(self.n_jobs)
        model = _default_model(self.physics) if self.model is None else self.model
        require_regressor(model)
        require_lssvm(model, self.physics)
        require_turn_on(self.turn_on_deg_h)
        require_averaging(self.averaging_s)
        if not runs:
            raise InputError("no runs to train on; give at least one recording")
        for run in runs:
            require_raw(run.name, run.columns)
        require_distinct(runs)
        raw, (runs, outliers) = runs, without_outliers(runs, self.gyro) if screen else (runs, [])
        candidates = pipeline_for(runs, self.features)
        require_no_gyro(runs, self.features, self.gyro)
        further, no_inputs = further_monitors(runs, self.features, candidates, self.gyro)
        self.pipeline_ = FeatureRecipe((*candidates.features, *map(Level, further)))
        samples = [self.pipeline_.transform(run).to_numpy()[run.scored] for run in runs]
        self.training_ = tuple(window_means(run, self.pipeline_, self.averaging_s, self.gyro) for run in runs)
        self.unused_: dict[str, float] = {}
        self.untold_ = UntoldInputs()
        not_told_apart: list[Message] = []
        if "all" in feature_names(self.features):
            chosen = ChosenInputs.of(self.pipeline_, self.training_, samples, further)
            self.pipeline_, self.training_, samples = chosen.pipeline, chosen.training, chosen.samples
            self.unused_, self.untold_, not_told_apart = chosen.unused, chosen.untold, chosen.remarks
        hybrid = HybridInputs.of(self.physics, runs, self.pipeline_, self.training_, samples, self.averaging_s, self.gyro)
        self.pipeline_, self.training_, samples = hybrid.pipeline, hybrid.training, hybrid.samples
        self.gyro_ = runs[0].gyro_column(self.gyro)
        self.specification_ = specification_of(model)
        reach = 0.0 if self.specification_ is None else self.specification_.reach
        self.scaling_ = Scaling.of(self.training_, samples, reach, self.pipeline_.physics)
        if not self.keep_mean:
            warn_of_earth_rate(self.scaling_.y_mean_deg_h, runs)
        X, y, groups = self.training_rows()
        if len(runs) == 1:
            logger.warning(
                "one run only: %d blocks of it choose the model, each predicted from the others; expect larger errors on "
                "another programme",
                BLOCKS_OF_ONE_RUN,
            )
        model = _resolved(model, self.pipeline_, one_run=len(runs) == 1)
        self.selection_ = (
            Selection({}, None, pd.DataFrame())
            if self.specification_ is None
            else select(self.specification_, model, X, y, groups, journal=journal, n_jobs=workers, progress=progress)
        )
        self.model_ = model.set_params(**self.selection_.best)
        self.model_.fit(X, y, **grouping(self.model_, self.run_labels()))
        self.interval_ = self.calibrated_interval()
        without_physics = self._rmse_without_physics(X, y, groups, workers)
        self.provenance_ = [
            {"run": run.name, **run.metadata.to_mapping(), "rows": len(run), "hours": run.duration_s / 3600.0} for run in raw
        ]
        self.remarks_ = (
            *outliers,
            *nearly_standard(runs, self.features),
            *omitted_groups(runs, self.features),
            *no_inputs,
            *not_told_apart,
            *hybrid.left_out,
            *on_gain(self.selection_.rmse, without_physics, self.scaling_.y_scale_deg_h),
            *on_amplitudes(self.parts(), self.amplitudes()),
            *on_selection(self.selection_, self.model_, self.training_, self.scaling_),
            *on_constant_inputs(self.training_, self.pipeline_),
            *on_leading_thermometer(runs, self.pipeline_),
            *on_interval(self.interval_),
            *on_errors_below_noise(self.selection_.rmse, self.scaling_, raw, self.gyro, self.averaging_s),
            *on_turning(self.scaling_, self.pipeline_.columns),
        )
        for remark in self.remarks_:
            logger.warning("%s", remark)
        self.schema_ = SCHEMA
        self.restart()
        return self

    def _rmse_without_physics(self, X: Array, y: Array, groups: npt.NDArray[np.int64], workers: int) -> float | None:
        """Error with runs left out of the default model on the same rows, without the known physics; None where there is none, or
        where many rows make it long.
        """
        if not self.pipeline_.physics or len(y) > MANY_ROWS:
            return None
        features = FeatureRecipe(tuple(feature for feature in self.pipeline_.features if feature.kind != PhysicsTerm.kind))
        model = _resolved(_default_model(None), features, one_run=len(self.training_) == 1)
        return select(MODELS[DEFAULT], model, X[:, self.scaling_.ranged], y, groups, n_jobs=workers).rmse

    def training_rows(self) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        """Scaled inputs, scaled output and fold label of every training row."""
        return scaled_rows(self.training_, self.scaling_)

    def run_labels(self) -> npt.NDArray[np.int64]:
        """Number of the run that each training row belongs to."""
        return run_labels(self.training_)

    def calibrated_interval(self) -> Interval:
        """From the errors of the selected model on runs left out."""
        errors = HeldOutErrors.of(self.model_, self.training_, self.scaling_)
        return errors.with_other_gyros(self.model_, self.scaling_).interval(self.turn_on_deg_h)

    # --- tables ------------------------------------------------------------------------------------------------------------

    def contributions(self) -> pd.DataFrame:
        """How much of the estimated bias each input makes: its change where the input alone stays at its mean over training.

        Inputs that go together share one effect, so that their contributions may be large and cancel.

        Returns
        -------
        pandas.DataFrame
            `input`, and `rms_deg_h` over the training rows, the largest first.

        Raises
        ------
        InputError
            It is not fitted.
        """
        self.require_fitted()
        X = np.vstack([part.X for part in self.training_])
        return self._estimate.contributions(X, self.pipeline_.names)

    def parts(self) -> pd.DataFrame:
        """What each part of a compensation with known physics does, over the training rows.

        Returns
        -------
        pandas.DataFrame
            `part`: each mechanism, and the LS-SVM; `rms_deg_h` about its mean; `share` of the bias's variance that goes with it, so
            that the shares of all parts sum to 1. Empty without known physics.

        Raises
        ------
        InputError
            It is not fitted.
        """
        self.require_fitted()
        return parts_of(self.pipeline_, self.scaling_, self.model_, np.vstack([part.X for part in self.training_]))

    def amplitudes(self) -> pd.DataFrame:
        """The amplitudes of known physics.

        Returns
        -------
        pandas.DataFrame
            `mechanism`, `parameter`; the fitted `value` with its `sd`, and the value `given` by the simulator.

        Raises
        ------
        InputError
            It is not fitted.
        """
        self.require_fitted()
        return amplitudes_of(self.pipeline_, self.scaling_, self.model_)

    def plot(self, ax: Any = None) -> Any:
        """Contribution of each input to the estimated bias, as :meth:`contributions` gives it.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            By default of a new figure.

        Returns
        -------
        Axes

        Raises
        ------
        InputError
            It is not fitted.
        """
        from rlgcomp.report.drawing import draw_bars

        table = self.contributions()
        return draw_bars(
            ax,
            [name.replace("_", " ") for name in table["input"]],
            table["rms_deg_h"].to_numpy(),
            label="rms of the bias that the input makes in training",
            unit="deg/h",
            title="Contribution of each input",
        )

    # --- serialisation -----------------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the artefact; see :mod:`rlgcomp.compensation.artefact`.

        Raises
        ------
        InputError
            The model is neither the package's own nor one that skops writes as data, or the place cannot be written to.
        """
        self.require_fitted()
        serialisation.save(path, self)


def _default_model(physics: Simulator | None) -> Any:
    return MODELS[DEFAULT].make() if physics is None else LSSVMRegressor()


def _resolved(model: Any, pipeline: FeatureRecipe, *, one_run: bool) -> Any:
    """A copy of the model with the parameters that follow from the runs and their features."""
    model = clone(model)
    if one_run and model.get_params().get("run_variance", 0.0) is None:
        model.set_params(run_variance=0.0)  # blocks of one run have one bias
    if pipeline.physics:
        model.set_params(linear=pipeline.physics, trend=False)
        if "linear_prior" in model.get_params():
            model.set_params(linear_prior=None)  # known physics extrapolates by its own laws
    if model.get_params().get("linear") == DYNAMICS:
        model.set_params(linear=pipeline.dynamic)
    return model


def load(path: str | Path) -> Compensator:
    """Read an artefact that :meth:`Compensator.save` wrote; its golden vectors must come out again.

    Raises
    ------
    InputError
        A file is missing, changed, or not what the manifest says; nothing is loaded then.
    """
    return serialisation.load(path, Compensator)
