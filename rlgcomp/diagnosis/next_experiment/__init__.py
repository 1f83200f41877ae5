"""Which run would tell apart what these runs do not.

Modules, each importing only from those before it:

    laboratory  monitors of a run that has not been made
    programmes  what a chamber or a table can run
    design      the next experiment
"""
