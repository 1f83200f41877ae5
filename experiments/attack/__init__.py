"""A second attack, which shares nothing with `experiments.fuzz`, `experiments.faults` and `experiments.silent_faults`.

Files are made anew from random parts or spliced, not mutated; whole commands read them; kills and failing calls hit chosen changes
of the file system, not moments; recordings come from a gyro of its own, not from the package's simulator.
"""
