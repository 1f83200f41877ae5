"""Diagnosis: what physics a simulator is missing. :mod:`rlgcomp.diagnosis.engine.diagnose` is one from beginning to end."""
