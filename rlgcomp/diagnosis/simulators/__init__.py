"""Simulators of the user's own: their output or a Python function, brought onto the recording's clock and rows.

Modules, each importing only from those before it:

    resampling      a simulation on the rows of a recording
    align           the clock of a simulation against that of a recording
    user_simulator  the simulator itself: a file a run, or a function of monitors
"""
