"""Diagnosis: detect the mismatch between a simulator and recordings, locate it, name what is missing, model it, prove it.

One diagnosis from beginning to end is :func:`rlgcomp.diagnosis.diagnose.diagnose`. Beside it: runs that can be compared
(`comparable`), what they are asked (`posed`), what may be apart in some of them (`bias_steps`, `partly`), what answers in the end
(`answer`, `conclusion`), and what the reader is told (`account`, `remarks`).

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
"""
