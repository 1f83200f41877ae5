"""Bias compensation from readout signals: Opt. Express 23, 13320 (2015), reproduced on simulated gyro units.

    python -m experiments.optica_2015 --units 10 --out DIR
    python -m experiments.optica_2015 --mechanisms
    python -m experiments.optica_2015 --nearest 4

Each unit is drawn at random from physical parameters (:func:`rlgcomp.simulated_unit`); none is tuned to a row of the paper. As
there, the 680-minute chamber programme is run twice: the first run trains, its parameters selected on five blocks of it, and the
second tests. Tables 1 to 4 of the paper are images
that its text does not repeat, so the published numbers are the four that the text states.
"""
