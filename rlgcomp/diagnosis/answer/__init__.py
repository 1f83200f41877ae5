"""What the likely sets say: weights, probabilities, whether anything is missing, and scores of runs.

Modules, each importing only from those before it:

    fit         weights, predictions
    mismatch    whether anything is missing, and where
    left_over   runs of which more is left than noise
    posterior   probabilities of sets and regions
    black_box   the compensation at its best on the same split
    scores      runs before and after
"""
