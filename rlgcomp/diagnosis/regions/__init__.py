"""What is searched: the simulator, and regions of forms, each a mechanism's name, a law or a nuisance.

Modules, each importing only from those before it:

    setting     what builders of regions read
    loops       families of relays: hysteresis and mode hops
    baseline    the simulator, linearised in its free numbers
    selections  terms in some of the runs, amplitudes by run
    passages    hops whose thresholds scatter
    waves       lines that a residual proposes, and smooth wanders
    thermal     families of forms of the temperature
    switch_on   families of forms of the time since switch-on
    monitors    regions of recorded monitors, and laws that no mechanism has
    chamber     regions that mechanisms name in chamber runs
    turntable   rows and regions where a table turns
    lateness    columns that are late
    clocks      the clock of a user's simulation
    nuisances   steps of the bias, biases of runs, late columns, stated numbers that are wrong
"""
