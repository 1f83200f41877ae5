"""Diagnosis on one model: terms are driver × memory × form × selection, compared by one evidence.

docs/diagnosis.md has the equation, the parts of the model and their priors. To follow a recording begin at the end: `diagnose`
calls prepare, case and choice, which search, and then answer, equations and report.

Rooms and modules, each importing only from those before it (`tests/test_architecture.py`); a room's own list is in its docstring:

    priors           every number of the prior, with its reason
    data             window means of runs, and their columns on a finer grid
    forms            what a term is made of: a driver, its memory, a form of that as columns
    noise            hypotheses of the noise, and errors of drivers
    regions          the regions that are searched: mechanisms by name, laws, nuisances; the simulator
    evidence         the evidence of a set, and of many sets at once
    search           which sets are likely: a beam over sets, each polished
    answer           weights, probabilities, whether anything is missing, scores
    decide           what is stated: every threshold
    simulators       simulators of the user's own, on the clock and rows of the recording
    equations        what was found as equations, tables and a simulator file
    report           the record of a diagnosis, as text, pictures and a page
    next_experiment  which run would tell apart what these do not
    conventions      time stamps of a table's motion
    prepare          runs without outliers; a user's own simulation
    case             what a diagnosis weighs: runs on one grid, regions, the simulator calibrated
    choice           what the runs that choose say: the posterior, shapes calibrated beside the likeliest set
    diagnose         one diagnosis from beginning to end
"""
