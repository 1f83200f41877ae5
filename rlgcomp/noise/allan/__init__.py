"""Allan deviations, the noise they show, and whether it holds all along: what `rlgcomp allan` says of a gyro."""
