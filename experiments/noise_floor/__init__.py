"""How near the default model on all features comes to the noise floor, on a chamber programme it was not trained on.

    python -m experiments.noise_floor --units 10

Units are drawn at random; their thermal hysteresis follows one of three laws, of which the features share only the first (play).
"""
