"""Scale factor of a rate-biased gyro to 1e-7: Chinese J. Lasers 37, 1327 (2010), its numbers beside ours.

    python -m experiments.zhan_2010 [--quick] [--out DIR]

The paper's measurements are not published, only their means and spreads: what follows from those is recomputed, and the rest is
simulated with the errors that it states for its tables.
"""
