"""What a term is made of: a driver, a memory of it, and a form of that as columns with Gaussian weights.

Modules, each importing only from those before it:

    hashed          hashes of frozen objects, kept
    drivers         what acts: recorded columns, differences, time since switch-on
    bases           forms of drivers as columns with Gaussian weights
    relaxations     lags of one time constant or many
    histories       what was before a run
    memories        plays, relays and densities of them
    times           bases of the time in a run: laws of switch-on, waves
    terms           forms and regions: a mechanism is the name of a region
    nonlinearities  saturations, dead zones, powers
    symmetries      laws of a column that changes its sign
"""
