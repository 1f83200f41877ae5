"""Naming: sets of causes weighed against each other by their evidence, and asked of held-out runs."""
