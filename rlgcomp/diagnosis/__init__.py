"""Diagnosis: detect the mismatch between a simulator and recordings, locate it, name what is missing, model it, prove it.

One diagnosis from beginning to end is :func:`rlgcomp.diagnosis.diagnose.diagnose`. Beside it: runs that can be compared
(`comparable`), what they are asked (`posed`), a simulation's clock that no monitor tells (`clocks`), what may be apart in some runs
(`bias_steps`, `partly`), what answers in the end (`answer`, `conclusion`), and what the reader is told (`account`, `remarks`).

Rooms, each importing only from those before it:
    result        what a diagnosis says: findings, fits, in words, as a page, in pictures
    noise         which noises there may be, and how each is made white
    question      windows of the recordings less what the simulator says for certain
    naming        evidence of sets of causes; held-out runs asked about them
    fitting       parameters of a chosen set, with their standard deviations
    laws          laws beyond the catalogue, sifted
    detection     is there anything, and where
    proof         held-out runs before and after, beside a black box
    simulators    a user's own simulator, on the recording's clock
    programmes    the programme that would tell most

Words, and what the literature calls them:
    wander        a Gauss–Markov (Ornstein–Uhlenbeck) process of a cause that was not recorded
    jumps, path   a random telegraph process, and the sequence of its states
    law           a regression term for which the catalogue has no mechanism
    loop          rate-independent hysteresis
    toll          what a further cause must exceed for model discrepancy of those beside it (Kennedy and O'Hagan)
    known         in the simulator already, with numbers that it states; a set of such causes alone is innocent
    own bias      turn-on to turn-on bias: each run has its own
    fast          computed at the full rate of samples, since it acts within averaging windows
    contrasts     orthonormal comparisons of samples within averaging windows
    loudness      variance of a window's white noise over that of the runs' middle one
"""
