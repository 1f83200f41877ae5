"""The order of remarks: first those by which a result fails, then those that limit it, then those on what was done."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from rlgcomp.report.messages import Message

DECISIVE: Final = frozenset(
    {
        "calibration.chi_squared_unexpected",
        "calibration.counter_does_not_follow",
        "calibration.lock_in_does_not_explain_the_curve",
        "calibration.mounting_angle_near_zero",
        "calibration.navigator_worse",
        "calibration.parameters_not_determined",
        "challenge.missed_at_largest_strength",
        "challenge.unexplained_before",
        "compensation.no_gain",
        "compensation.other_unit",
        "compensation.physics_worse",
        "diagnosis.clock_beyond_its_runs",
        "diagnosis.compensation_better",
        "diagnosis.findings_worse",
        "diagnosis.learnt_from_columns",
        "diagnosis.left_over",
        "diagnosis.no_clock",
        "diagnosis.simulation_scaled",
        "evaluation.model_trained_on",
        "evaluation.no_gain",
        "evaluation.trained_on",
        "evaluation.worse",
        "evaluation.worse_with_offset",
        "noise.angle_random_walk_not_resolved",
        "noise.cross_check_disagrees",
        "noise.misfit",
        "noise.not_stationary",
        "noise.spectrum_misfit",
        "recording.coarse_gyro",
        "recording.exchanged_thermometers",
        "recording.other_response",
        "recording.other_sign",
        "recording.unit_contradicts_table",
    }
)
LIMITING: Final = frozenset(
    {
        "calibration.biases_differ_between_runs",
        "calibration.gyros_cross_zero_rate",
        "calibration.gyros_hardly_turn",
        "calibration.no_accelerometers",
        "calibration.one_repeat",
        "calibration.outliers",
        "calibration.outlying_repeat",
        "calibration.parameters_correlated",
        "calibration.pulse_taken_as_scale_factor",
        "calibration.table_moved",
        "challenge.absorbed_by_the_simulator",
        "challenge.far_above_usual_size",
        "challenge.found_at_smallest_strength",
        "compensation.amplitudes_unknown",
        "compensation.adapted_to_known",
        "compensation.constant_within_runs",
        "compensation.like_runs_alone",
        "compensation.offsets_between",
        "compensation.parts_cancel",
        "compensation.zeroed_by_noise",
        "compensation.zeroed_throughout",
        "compensation.zeroed_with_earth_rate",
        "diagnosis.approximate",
        "diagnosis.bias_step",
        "diagnosis.cancelling",
        "diagnosis.extrapolated",
        "diagnosis.file_differs",
        "diagnosis.file_gain",
        "diagnosis.gain_of_numbers",
        "diagnosis.indistinguishable",
        "diagnosis.jumps",
        "diagnosis.late_monitor",
        "diagnosis.late_thermometer",
        "diagnosis.noise_not_as_stated",
        "diagnosis.null_possible",
        "diagnosis.perhaps_nothing",
        "diagnosis.phase_by_run",
        "diagnosis.rested",
        "diagnosis.run_lacks_column",
        "diagnosis.scattered_thresholds",
        "diagnosis.set_uncertain",
        "diagnosis.telegraph_not_in_file",
        "diagnosis.unidentified",
        "diagnosis.unsettled",
        "diagnosis.unstated",
        "diagnosis.wrong_number",
        "evaluation.adds_noise",
        "evaluation.cubic_suffices",
        "evaluation.offset",
        "evaluation.out_of_range",
        "evaluation.untold",
        "noise.base_motion",
        "noise.base_motion_limits",
        "noise.curve_ends_early",
        "noise.encoder_delay_unknown",
        "noise.narrow_lines",
        "noise.pulse_beat",
        "noise.table_turns",
        "noise.temperature_changes",
        "noise.turntable",
    }
)
LEVELS: Final = ("decisive", "limiting", "note")


def level(one: Message) -> str:
    """One of :data:`LEVELS`: the result or its proof fails; it holds within limits; or what was done is told."""
    return LEVELS[0] if one.code in DECISIVE else LEVELS[1] if one.code in LIMITING else LEVELS[2]


def by_consequence(messages: Iterable[Message]) -> tuple[Message, ...]:
    """Messages, the most consequential first; within a level their order stays."""
    return tuple(sorted(messages, key=lambda one: LEVELS.index(level(one))))
