"""Compensation: features of a recording, the selection of a model over runs, and the compensator that joins them; its models are in
:mod:`rlgcomp.compensation.models`."""

from rlgcomp.numerics.late_imports import import_late

import_late("scipy.stats")
