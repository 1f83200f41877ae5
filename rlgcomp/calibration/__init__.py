"""Calibration on turntables: scale factor, mounting angle, dependence on rate, alignment, and the errors of a triad."""
