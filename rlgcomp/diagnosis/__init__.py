"""Diagnosis: detect the mismatch between a simulator and recordings, locate it, name what is missing, model it, prove it."""
