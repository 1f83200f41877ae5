"""Simulators of the user's own: their output or a Python function, brought onto the recording's clock and rows."""
