"""Goals of compensations that no other experiment measures: one-way runs, turn-on biases, folds with run borders, C of a hybrid.

python -m experiments.compensation_goals [--section one-way]
"""
