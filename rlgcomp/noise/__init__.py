"""Noise: processes and their simulation, Allan deviations with coefficients, and the angle random walk of a gyro that turns."""
