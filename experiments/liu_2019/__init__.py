"""Z. Liu et al., Sensors 19, 4754 (2019): every published number beside ours."""
