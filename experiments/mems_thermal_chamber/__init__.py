"""A real thermal cycle: a MEMS IMU cooled, heated and cooled again; trained on the first two legs, held out on the third.

    python -m experiments.mems_thermal_chamber [--section compensation|diagnosis]

Reads `../shared/data/real/mems_imu_thermal_chamber` (or --data FOLDER), which is not part of the project. The default lags and
memory radii of the features were chosen on simulated units and on this recording, so that these numbers are held out for the
coefficients but not for that choice.

In diagnosis the simulator is what industry does, a cubic polynomial in temperature, and each leg is a run. The accelerometers are
outputs of the same unit, no drivers, and are left out. It is made twice: with the mechanisms by which a bias remembers temperature,
and with the whole catalogue, of which much is laser physics that a MEMS does not have. With one cycle the answer depends on such
choices, and on the averaging time: the sentences say what is not to be believed.
"""
