"""How many hours in the chamber a new gyro needs: adapted from a fleet, beside training from scratch.

    python -m experiments.new_unit [--quick] [--fleet 12] [--units 12] [--jobs 2]

The fleet's units were each run through two programmes. A new unit has the first hours of one of them, and is scored on another
programme. Units differ by signs and by 30 % in every size, so their mean alone is of little use to a new one.
"""
