"""Calibration on turntables: what a gyro's pulses are worth, about which axis, at which rate, and what alignment makes of it."""
