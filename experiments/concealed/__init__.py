"""Concealed physics: recordings made by another implementation of the physics than the one that diagnoses them, and its score."""
