"""Laws outside the catalogue: the search of rlgcomp.diagnosis.discover beside plain sparse regression, on concealed physics."""
