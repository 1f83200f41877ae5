"""Bias, scale factors and misalignments of three gyros from runs on a two-axis table."""
