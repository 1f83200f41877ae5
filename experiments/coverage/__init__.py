"""Whether 90 % intervals hold 90 %: windows of runs held out, many units, random chamber programmes, models and laws of hysteresis.

    python -m experiments.coverage [--quick] [--units 20] [--jobs 2]
    python -m experiments.coverage --turn-on [--units 10]
    python -m experiments.coverage --legs

Every run has a chamber programme of its own, drawn at random; none is trained on and tested on. A window is a mean over 100 s.
With --turn-on each run has a bias of its own, of 0.01 deg/h rms, drawn several times for the same runs.
With --legs it is the three legs of a real thermal cycle instead, each held out in turn: runs that are not of one kind.
"""
