"""Known physics of a compensation: the mechanisms of a simulator as causal terms, and what of a simulator has no causal form.

A simulator's mechanisms are computed from whole recordings and may look ahead: slopes over centred windows, readings smoothed both
ways. A navigation computer cannot, so that a compensation has the causal form of each mechanism: the nonlinear parameters
(thresholds, time constants, widths of loops, tables) stay as the simulator has them, and every amplitude becomes the coefficient of
a column that is fitted with the model.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.causal_forms import NoCausalFormError, columns_of
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.models.lssvm import LSSVMRegressor
from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.compensation.window_means import Scaling, WindowMeans, window_means
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
LEARNT: Final = "LS-SVM"  # the part that is no known physics
_ROUNDING: Final = 1e-10  # of the bias, below which it has no part
CLEARLY_WORSE: Final = 1.1  # times the error without known physics
MOST_SHARE: Final = 1.2  # of the bias's variance in one part: another takes off what it has too much
WELL_KNOWN: Final = 5.0  # standard deviations of the best known amplitude of a part from zero
CERTAIN: Final = 2.0  # standard deviations of an amplitude from zero


@dataclasses.dataclass(frozen=True)
class KnownPhysics:
    """Terms of a simulator.

    Parameters
    ----------
    terms : tuple of PhysicsTerm
    left_out : tuple of Message
        Mechanisms without a causal form, each with the reason.
    """

    terms: tuple[PhysicsTerm, ...]
    left_out: tuple[Message, ...]


def known_physics(simulator: Simulator, runs: Sequence[Recording]) -> KnownPhysics:
    """The causal terms of a simulator for these runs.

    Parameters
    ----------
    simulator : Simulator
        Of a chamber.
    runs : sequence of Recording
        The training runs; they choose the thermometer, and over how long its slope is taken.

    Raises
    ------
    InputError
        It is no simulator of a gyro in a chamber, a run lacks a monitor, or none of its mechanisms has a causal form.
    """
    if not isinstance(simulator, Simulator):
        raise InputError(f"physics is a {type(simulator).__name__}; give a Simulator, as diagnosis.augmented or from its file")
    if simulator.output:
        raise InputError(
            f"physics: the simulator is of {simulator.output}, and a compensation is of a gyro; give a simulator without `output`, "
            "in the gyro's unit"
        )
    if simulator.kind != "chamber":
        raise InputError("physics: the simulator is of a turntable; a compensation takes the physics of a chamber simulator")
    terms: list[PhysicsTerm] = []
    left_out: list[Message] = []
    labels: dict[str, int] = {}
    for mechanism in simulator.mechanisms:
        for run in runs:
            mechanism.driver_columns(run)  # refuses a run that lacks one
        cause = getattr(mechanism, "cause", "") or mechanism.name
        labels[cause] = labels.get(cause, 0) + 1
        label = cause if labels[cause] == 1 else f"{cause} {labels[cause]}"
        try:
            found = _terms(mechanism, label, runs)
        except NoCausalFormError as reason:
            left_out.append(message("compensation.physics_left_out", mechanism=label, reason=str(reason)))
            continue
        terms += found
    if not terms:
        why = "; ".join(one.text for one in left_out) or "it has no mechanism beside a constant bias"
        raise InputError(f"physics: nothing of the simulator can serve a compensation: {why}")
    return KnownPhysics(tuple(terms), tuple(left_out))


def _terms(mechanism: Mechanism, label: str, runs: Sequence[Recording]) -> list[PhysicsTerm]:
    """A mechanism's columns, less a constant, which the model's intercept is."""
    amplitudes = [p.name for p in mechanism.amplitude_parameters() if p.name != mechanism.constant]
    columns = columns_of(mechanism, mechanism.driver_columns(runs[0]), runs)
    names = [*amplitudes, *(f"part_{k + 1}" for k in range(len(amplitudes), len(columns)))]
    return [
        PhysicsTerm(mechanism=label, parameter=name, given=float(getattr(mechanism, name, 0.0)), **column)
        for name, column in zip(names, columns, strict=False)
    ]


@dataclasses.dataclass(frozen=True)
class HybridInputs:
    """The inputs of a compensation with known physics.

    Parameters
    ----------
    pipeline : FeatureRecipe
        The kernel's features, and after them the terms of known physics.
    training : tuple of WindowMeans
    samples : list of ndarray, shape (samples, features)
        Features of every scored sample, run by run.
    left_out : tuple of Message
    """

    pipeline: FeatureRecipe
    training: tuple[WindowMeans, ...]
    samples: list[Array]
    left_out: tuple[Message, ...]

    @classmethod
    def of(
        cls,
        simulator: Simulator | None,
        runs: Sequence[Recording],
        pipeline: FeatureRecipe,
        training: Sequence[WindowMeans],
        samples: Sequence[Array],
        averaging_s: float,
        gyro: str | None,
    ) -> Self:
        """The terms of a simulator after the features of a pipeline; these alone without one.

        Parameters
        ----------
        simulator : Simulator, optional
        runs : sequence of Recording
            The training runs.
        pipeline : FeatureRecipe
        training : sequence of WindowMeans
        samples : sequence of ndarray, shape (samples, features)
        averaging_s : float
        gyro : str, optional
        """
        if simulator is None:
            return cls(pipeline, tuple(training), list(samples), ())
        physics = known_physics(simulator, runs)
        terms = FeatureRecipe(physics.terms)
        means = [window_means(run, terms, averaging_s, gyro).X for run in runs]
        of_terms = [terms.transform(run).to_numpy()[run.scored] for run in runs]
        return cls(
            FeatureRecipe((*pipeline.features, *terms.features)),
            tuple(dataclasses.replace(part, X=np.hstack([part.X, X])) for part, X in zip(training, means, strict=True)),
            [np.hstack(pair) for pair in zip(samples, of_terms, strict=True)],
            physics.left_out,
        )


def require_lssvm(model: Any, physics: Simulator | None) -> None:
    """Refuse known physics for other models than the LS-SVM.

    Raises
    ------
    InputError
        There is known physics, and the model is another one, or on a device.
    """
    if physics is not None and not (isinstance(model, LSSVMRegressor) and model.device is None):
        raise InputError(
            f"physics is for the lssvm model without a device, not for a {type(model).__name__}; leave one of them out"
        )


def parts_of(pipeline: FeatureRecipe, scaling: Scaling, model: Any, X: Array) -> pd.DataFrame:
    """What each part of a fitted model does on rows; empty where it has no known physics.

    Parameters
    ----------
    pipeline : FeatureRecipe
    scaling : Scaling
    model : LSSVMRegressor
    X : ndarray, shape (n, features)
        Unscaled.
    """
    columns = ["part", "rms_deg_h", "share"]
    if not scaling.linear:
        return pd.DataFrame(columns=columns)
    scaled = scaling.inputs(X)
    owners = [feature.mechanism for feature in pipeline.features if isinstance(feature, PhysicsTerm)]
    values = {owner: np.zeros(len(X)) for owner in owners}
    for owner, place, coefficient in zip(owners, scaling.linear, model.coef_, strict=True):
        values[owner] += scaling.y_scale_deg_h * coefficient * scaled[:, place]
    bias = scaling.y_scale_deg_h * model.predict(scaled)
    rest = bias - sum(values.values(), np.zeros(len(X)))
    values[LEARNT] = np.zeros(len(X)) if np.std(rest) < _ROUNDING * np.std(bias) else rest
    total = float(np.var(bias)) or 1.0
    about = bias - bias.mean()
    rows = [[part, float(np.std(one)), float(np.mean((one - one.mean()) * about)) / total] for part, one in values.items()]
    return pd.DataFrame(rows, columns=columns)


def amplitudes_of(pipeline: FeatureRecipe, scaling: Scaling, model: Any) -> pd.DataFrame:
    """The amplitudes of known physics: fitted, with their standard deviations, and as given."""
    terms = [feature for feature in pipeline.features if isinstance(feature, PhysicsTerm)]
    per_unit = scaling.y_scale_deg_h / scaling.scale[list(scaling.linear)]
    fitted = zip(terms, per_unit, model.coef_, model.coef_std_, strict=True) if terms else ()
    rows = [
        [term.mechanism, term.parameter, float(factor * value), float(factor * sd), term.given]
        for term, factor, value, sd in fitted
    ]
    return pd.DataFrame(rows, columns=["mechanism", "parameter", "value", "sd", "given"])


def on_gain(rmse: float | None, without_physics: float | None, y_scale_deg_h: float) -> list[Message]:
    """A message where the errors with runs left out are clearly larger than those of the default model without known physics."""
    if rmse is None or without_physics is None or not rmse > CLEARLY_WORSE * without_physics:
        return []
    errors = {"residual_deg_h": rmse * y_scale_deg_h, "without_deg_h": without_physics * y_scale_deg_h}
    return [message("compensation.physics_worse", **errors)]


def on_amplitudes(parts: pd.DataFrame, amplitudes: pd.DataFrame) -> list[Message]:
    """Messages on uncertain parts that cancel each other, and on mechanisms whose only amplitude is not told from zero.

    Parameters
    ----------
    parts, amplitudes : pandas.DataFrame
        As :func:`parts_of` and :func:`amplitudes_of` make them.
    """
    messages = []
    if len(parts) and parts["share"].max() > MOST_SHARE:
        large = parts[parts["share"].abs() > MOST_SHARE - 1.0]
        shares = dict(zip(large["part"], (100.0 * large["share"]).tolist(), strict=True))
        known = (amplitudes["value"].abs() / amplitudes["sd"]).groupby(amplitudes["mechanism"]).max().to_dict()
        if min(known.get(part, 0.0) for part in shares) < WELL_KNOWN:  # a lag or a play opposes the temperature that it follows
            messages.append(message("compensation.parts_cancel", shares=shares))
    unknown = amplitudes[~amplitudes["mechanism"].duplicated(keep=False) & (amplitudes["value"].abs() < CERTAIN * amplitudes["sd"])]
    if len(unknown):
        found = [f"{row.mechanism}.{row.parameter} {row.value:.2g} ± {row.sd:.2g}" for row in unknown.itertuples()]
        messages.append(message("compensation.amplitudes_unknown", amplitudes=found))
    return messages
