"""Diagnosis on one model: terms are driver × memory × form × selection, compared by one evidence.

docs/diagnosis.md has the equation, the parts of the model and their priors.

Modules, each importing only from those before it (`tests/test_architecture.py`):
    priors      every number of the prior, with its reason
    data        window means of runs, and their columns on a finer grid
    hashed      hashes of frozen objects, kept
    drivers     what acts: recorded columns, differences, time since switch-on
    bases       forms of drivers as columns with Gaussian weights
    relaxations  lags of one time constant or many
    histories   what was before a run
    memories    plays, relays and densities of them
    times       bases of the time in a run: laws of switch-on, waves
    terms       forms and regions: a mechanism is the name of a region
    nonlinearities  saturations, dead zones, powers
    symmetries  laws of a column that changes its sign
    setting     what builders of regions read
    loops       families of relays: hysteresis and mode hops
    baseline    the simulator, linearised in its free numbers
    selections  terms in some of the runs, amplitudes by run
    waves       lines that a residual proposes, and smooth wanders
    regions     the regions that are searched
    turning     rows and regions where a table turns
    lateness    columns that are late
    clocks      the clock of a user's simulation
    nuisances   steps of the bias, biases of runs, late columns, stated numbers that are wrong
    errors      errors of drivers, which join the noise
    noise       a noise by its parameters, and whitening by it
    hypotheses  the noises that are tried, with their prior
    identities  columns that are readings of the output, and so no cause
    recent      what was last asked for, kept
    bank        window means of bases, computed once
    evidence    the evidence of a set of forms in closed form
    screen      the evidence of many forms at once
    variants    the same of forms that differ in a basis or two
    pairs       the same of pairs of forms
    members     a member of a set: chosen, polished, grown
    process     what stands beside a set, seen window by window
    telegraph   a two-state process beside a set
    jumps       the rival of that: jumps to levels of their own
    unrecorded  the other rival: something that wanders and acts through a function
    states      a set at its best: its noise, its forms, errors of its drivers
    shapes      free shapes of the simulator, calibrated anew beside a set
    sharpening  the set that is fitted, at its finest
    search      a beam over sets
    fit         weights, predictions
    mismatch    whether anything is missing, and where
    posterior   probabilities of sets and regions
    black_box   the compensation at its best on the same split
    simulators  simulators of the user's own, on the clock and rows of the recording
    lines       frequency and width of a line that is not its mechanism's own
    time_laws   parameters of a law of time in its own equation
    decide      what is stated: every threshold
    stated      equations as they were found, and names of their numbers
    parameters  parameters of an equation, and whether it describes a term
    tabulated_laws  bases with their weights as tables of a simulator file
    simulator_file  the fitted model as a simulator: mechanisms, and tables where none expresses a term
    functions   members as tables over a driver, over time, as responses, as loops
    switches    where a sum of a few relays switches, and its steps
    equations   equations as LaTeX and expressions, and what their symbols mean
    findings    members with their parameters, their functions and their rivals
    scores      runs before and after
    record      the data of a diagnosis; remarks, text, pictures and page read it
    remarks     headline, gain and remarks
    text        a diagnosis as text, and the cells of its tables
    pictures    pictures of a diagnosis
    page        the page of a diagnosis
    result      the diagnosis as scripts use it
    laboratory  monitors of a run that has not been made
    programmes  what a chamber or a table can run
    design      the next experiment
    conventions  time stamps of a table's motion
    prepare     runs without outliers; a user's own simulation
    case        what a diagnosis weighs: runs on one grid, regions, the simulator calibrated
    choice      what the runs that choose say: the posterior, shapes calibrated beside the likeliest set
    diagnose    one diagnosis from beginning to end
"""
