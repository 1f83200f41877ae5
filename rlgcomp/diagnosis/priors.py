"""Every number of the prior, with its reason."""

from __future__ import annotations

from typing import Final

import numpy as np

# --- resolution of the data ----------------------------------------------------------------------------------------------------

WINDOWS: Final = 400
"""Windows of the longest run: a hop or a reversal is placed to a fraction of a per cent of a run; a Cholesky factor is small."""
WINDOWS_OF_ALL: Final = 1000
"""Windows of all runs: the time of a diagnosis grows with their number and the length of a run's Cholesky factor."""
BINS: Final = 5
"""Bins of a window, on which memories and forms are evaluated: a form does not commute with an average."""

# --- regions -------------------------------------------------------------------------------------------------------------------

NAMED_ODDS: Final = 0.03
"""Odds that a mechanism of the catalogue is missing: with some twenty of them, none is missing in half of all diagnoses."""
LAW_ODDS: Final = 0.002
"""Odds of a law without a name: there are ten times as many, and together they are as likely as two or three mechanisms."""
NUISANCE_ODDS: Final = 0.03
"""Odds of a step of the bias, of a bias a run, and of a stated number that is wrong: each about as usual as a missing mechanism."""
PART_OF_RUNS: Final = 0.05
"""Odds that an effect acts in some of the runs alone: a unit is repaired, a cable moved, a fan switched off between two runs."""
AMPLITUDE_BY_RUN: Final = 0.05
"""Odds that its amplitude differs from run to run, half of them by as much as it is, half by a little (:data:`DISCREPANCY`)."""
LATE_ODDS: Final = 1.0
"""Odds that a thermometer is late by more than a hundredth of a window: any may be."""
LATE_MONITOR_ODDS: Final = 0.3
"""Odds that another column is: most voltages, currents and fields are read at once, humidity, gases and slow loggers are not."""
CLOCK_ODDS: Final = 0.1
"""Odds that the clock of simulated runs is off where no monitor tells it: files begin at power-on or at a pulse."""
CLOCK_OFFSET: Final = 0.1
"""Largest offset of such a clock over the length of the shortest run: a simulation that is off by more covers another run."""
WANDER_ODDS: Final = 0.05
"""Odds that something unrecorded wanders: more usual than any one mechanism, as laboratories record half of what these follow."""
JUMPS_ODDS: Final = 0.02
"""Odds that something unrecorded jumps between levels of their own: a fan, a load or a valve with many settings."""
BENT_ODDS: Final = 0.025
"""Odds that something unrecorded wanders and acts through a function that bends: half as usual as in proportion."""

ANOTHER_PLACE: Final = 0.5
"""Weight of forms of another thermometer than the one that the catalogue means by temperature: a sensor sits where it can be
mounted, what reacts sits elsewhere."""

# --- sizes ---------------------------------------------------------------------------------------------------------------------

SIZES: Final = 0.2 * 3.0 ** np.arange(8)
"""Strength of a term over the white noise of a window mean, log-uniform: 0.2 can hardly be seen in a thousand windows, 440 is
beyond any recording in which a gyro still works. A ratio of three loses a tenth of a nat against a continuum."""
LATE: Final = (0.01, 0.3)
"""Lag of a thermometer in windows, log-uniform (the lag is the half of a normal variable of so large a standard deviation).
Sensors in or on a block answer within one second to half a minute, films and thermocouples the faster, cemented or potted elements
the slower (IEC 60751 asks for the time to 50 and 90 per cent of a step); a window is a four hundredth of a run, so half a minute
to a few minutes of runs of hours. A sensor that needed more than a window would follow no ramp of the programme that it is to
record, and whoever mounts it would see that."""
LATE_MONITOR: Final = (0.03, 3.0)
"""The same of another column: a capacitive humidity sensor answers within 8 to 60 s, an electrochemical cell or a barometer at the
end of a hose within minutes, and no mechanism has the rate of change of such a column for its own."""
PHASES: Final = (0.1, 0.3, 1.0, 3.0, 10.0)
"""How far the phase of a source of a period strays in a run, radians, each as likely: from a crystal's to a free motor's."""
SMOOTHNESSES: Final = (1.0, 3.0)
"""Knots of such a phase in its correlation length, each as likely: of a rough one, as of a hand that starts each swing, and of one
that is smooth, as a motor's in a flow."""
DISCREPANCY: Final = 0.12
"""Departure of a law from its equation over its own size: equations of the literature, fitted to other laws of the same cause,
leave 5 to 20 per cent."""

LEADING: Final = 1.0
"""Standard deviation of the logarithm of a form's leading strength over its own, below it: sizes are a factor of three apart."""

# --- forms ---------------------------------------------------------------------------------------------------------------------

SMOOTH_KNOTS: Final = 12
"""Functions of a smooth form: two bends of a range are resolved."""
SMOOTH_WIDTH: Final = 0.35
"""Correlation length of a smooth function over half the driver's range; polished as other shapes are."""
SMOOTHEST: Final = 2.0
"""And the longest: a function that hardly bends is a polynomial."""
TIME_CONSTANTS: Final = 12
"""Lags that are tried, in equal ratios from a window to a run: the next is within a sixth of an e-fold of any."""
SHORTEST_LAG: Final = 0.75
"""And the shortest, in windows: of a lag of half a window nothing is left but the rate of change, which has its own name."""
WARM_UP_LEFT: Final = 0.4
"""Of a warm-up, left at the end of the longest run, at most: an exponential of nine tenths of a run has three tenths left. What has
settled less is a line or a logarithm as far as the runs show, and is named so."""
THRESHOLDS: Final = 36
"""Levels of a relay that are tried over the range of its driver: polished afterwards."""
DEAD_BANDS: Final = (0.0, 0.03, 0.08, 0.16)
"""Dead bands of a relay over half the driver's range."""
WIDE_DEAD_BANDS: Final = (0.25, 0.4)
"""Of hops whose dead bands do not overlap: relays of so wide bands may be hops or a hysteresis; no run of the temperature parts
them."""
NARROWEST_LOOP: Final = 0.14
WIDEST_DEAD_BAND: Final = 0.17
WIDEST_OF_ONE: Final = 0.5
"""Over half the driver's range: among relays that overlap one with a wider dead band than the second is part of a hysteresis, whose
relays are laid a twelfth of the range apart; one with a narrower one than the first is a mode hop. Between them it may be either: a
range is that of the runs. No hop has a wider one than the third."""
SCATTER_ODDS: Final = 0.5
"""Odds that thresholds of a hop differ from passage to passage by more than a bin of a window shows."""
SCATTERS: Final = (0.003, 0.01, 0.03, 0.1)
"""By how much, over half the driver's range, each as likely: a path length follows its thermometer to a few hundredths."""
RADII: Final = tuple(float(r) for r in np.geomspace(0.04, 0.8, 7))
"""Radii of a play, over half the driver's range."""
RESTS: Final = (-0.6, 0.0, 0.6)
RESTS_APART: Final = 0.6
"""Where a driver rested before it went to the first value of each run, over half its range: units wait at the temperature of the
room, which programmes begin beside or far from."""
RESTS_BESIDE: Final = 0.2
"""The same for single relays, which are not polished together."""
UNSETTLED: Final = 0.5
"""How far from its driver a lag begins a run, over half the driver's range: recordings begin on a ramp, or before a unit has taken
the temperature of its room."""
CURVE_RADII: Final = (0.06, 0.14, 0.3, 0.7)
CURVE_CENTRES: Final = (-0.6, -0.3, 0.0, 0.3, 0.6)
CURVE_WIDTHS: Final = (0.15, 0.35, 0.8)
"""Of a curve that a hysteresis follows along the way of its driver, over half the range: polished afterwards."""
PREISACH_LEVELS: Final = 80
"""Levels of the Preisach plane, so 3160 relays, each elsewhere in its cell: at strength 30 their steps are lost in the noise."""
LAW_LEVELS: Final = 22
LAW_RELAYS: Final = 7
"""The same for loops of monitors, and of single relays of a monitor."""
ROUGH_LEVELS: Final = 56
"""The same where each relay departs by itself: 600 of them are within the range, next to which more are lost in the noise."""
RELAY_LEVELS: Final = 13
"""Levels of the plane of single relays over the range of the driver: 78 of them, polished afterwards."""
FURTHER_RELAYS: Final = 41
"""The same for one relay more."""
MORE_STEPS: Final = 0.7
"""Odds of one more hop of a ladder, of one more relay, lag, order of an angle, or step of the bias."""
HOPS: Final = THRESHOLDS * len((*DEAD_BANDS, *WIDE_DEAD_BANDS))
RELAYS: Final = FURTHER_RELAYS * (FURTHER_RELAYS - 1) // 2
"""Places of one more hop, at a level with a dead band, and of one more relay of a hysteresis, in the plane."""
MOST_STEPS: Final = 30
"""Members of a ladder, or relays, that are sought one by one."""

# --- noise ---------------------------------------------------------------------------------------------------------------------

FLICKERS: Final = {0.0: 0.45, 0.15: 0.2, 0.35: 0.2, 0.8: 0.11, 2.0: 0.04}
"""Bias instability over the white noise of a window mean."""
WALKS: Final = {0.0: 0.5, 0.3: 0.26, 1.0: 0.19, 3.0: 0.035, 10.0: 0.01, 30.0: 0.005}
"""Random walk gathered in a run of usual length, over the white noise of a window mean: data sheets of laser gyros give less than
one, those of small gyros up to a few; a larger one mostly is the response to something that was not recorded."""
WANDERS: Final = {1.5: 0.4, 4.0: 0.3, 10.0: 0.2, 25.0: 0.1}
"""Size of a wander of something unrecorded over the white noise of a window mean: a smaller one cannot be told from flicker."""
WANDERS_BESIDE_STATED: Final = {0.6: 0.25, 1.5: 0.3, 4.0: 0.2, 10.0: 0.15, 25.0: 0.1}
"""The same where flicker and random walk are stated, so that a small one can be told from them."""
STATED_ERROR: Final = 0.1
"""Relative error of a stated angle random walk without an error of its own: of a data sheet, or of half an hour's Allan curve."""
LEAST_STATED_ERROR: Final = 0.03
"""And the least: what was measured at rest holds no better in a chamber."""
STATED_SLOW_ERROR: Final = 0.25
"""Of bias instability and rate random walk: Allan curves end where these begin."""
ENCODERS: Final = {0.0: 0.5, 0.3: 0.17, 0.7: 0.17, 1.5: 0.1, 4.0: 0.06}
"""Noise of one reading of a table's angle over its period, over the white noise of a sample: half of all tables show none."""
FOLLOWING_RUNS: Final = 0.2
"""Weight of runs of which each began where the one before had ended, against runs after a rest: most units rest in between."""
OUTLIER_ODDS: Final = 1e-3
"""Odds that a window is an outlier: a knock, a glitch of a readout or of a monitor; one or two in a thousand windows."""
OUTLIER_SIZE: Final = 8.0
"""Its standard deviation over the white noise: from five on one is seen, beyond thirty it is repaired or a saturation."""
WANDER_TIMES: Final = (0.01, 0.03, 0.1, 0.3)
"""Correlation time of a wander over the length of a run."""
WANDER_TIMES_BY_SMOOTHNESS: Final = {False: WANDER_TIMES, True: (0.1, 0.3)}
"""The same of one that is rough, and of one that has a rate of change: no law makes up for a short one, which turns too often."""
SMOOTH_WANDERS: Final = 0.03
"""Share of wanders that are smooth: in one short run one is as good as any law that bends once, and a law says more. Over two runs
with a few turns each the data decide, by 4 to 50 nats."""
