"""De-noising of the training target: is a compensation better held out when its training runs are smoothed first?

    python -m experiments.denoising [--units 10] [--jobs 2] [--legs]

Compared are the recorded gyro, moving averages, a Rauch-Tung-Striebel smoother with the gyro's own noise model, and a wavelet
threshold (PyWavelets, extra `bench`). Runs held out are never smoothed. With --legs on the legs of a real thermal cycle.
"""
