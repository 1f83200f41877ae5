"""Calibration on turntables: scale factor, mounting angle, and the bias, scale factors and misalignments of a triad."""
