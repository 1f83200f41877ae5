"""Laws outside the catalogue: rlgcomp.diagnosis.laws beside plain sparse regression, on concealed physics."""
