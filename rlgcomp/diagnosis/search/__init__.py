"""Which sets are likely: members chosen, polished and grown beside each other, by a beam over sets.

Modules, each importing only from those before it:

    members     a member of a set: chosen, polished, grown
    process     what stands beside a set, seen window by window
    telegraph   a two-state process beside a set
    jumps       the rival of that: jumps to levels of their own
    unrecorded  the other rival: something that wanders and acts through a function
    states      a set at its best: its noise, its forms, errors of its drivers
    shapes      free shapes of the simulator, calibrated anew beside a set
    sharpening  the set that is fitted, at its finest
    beam        a beam over sets
"""
