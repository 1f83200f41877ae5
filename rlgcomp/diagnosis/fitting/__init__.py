"""The parameters of a chosen set of causes, with their standard deviations."""
