"""Methods of earlier papers beside the package's own: residual bias with runs held out, and the time that each takes.

    python -m experiments.earlier_compensations [--units 10] [--jobs 2] [--legs]

Sensor selection by the sum of squared errors, support vectors tuned by a particle swarm, and a small neural network, on the same
inputs, windows and folds as the cubic polynomials and the LS-SVM. The swarm is pymoo's (extra `bench`): pyswarms, the library of
that name, has had no release since January 2021. With --legs on the legs of a real thermal cycle.
"""
