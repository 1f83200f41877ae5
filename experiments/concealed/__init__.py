"""Concealed physics: recordings made by another implementation of the physics than the one that diagnoses them, and its score.

A case is planned (plan.py) and made (cases.py) of a chamber (chamber.py), effects of drawn forms (effects.py, functions.py,
operators.py), noise and a logger (noise.py, logger.py), or of a turntable (turntable.py). What could be known of it is computed
beside (informed.py). It is diagnosed and scored (score.py), and all rows make a page (page.py).
"""
