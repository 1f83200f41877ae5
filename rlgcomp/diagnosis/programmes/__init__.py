"""Programmes that a laboratory can run, and the one that would tell most."""
