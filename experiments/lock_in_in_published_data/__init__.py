"""Is a simulator with a linear scale factor enough for the measurements of Sensors 19, 4754 (2019), table 3?"""
