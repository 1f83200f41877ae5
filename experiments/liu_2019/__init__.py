"""A ring laser gyro in rate-biased mode: Sensors 19, 4754 (2019), its numbers beside ours.

python -m experiments.liu_2019 [--quick]
"""
