"""What happens in some of the runs alone, as a problem takes it in: a step of the bias, a cause that acts in a part of the runs."""

from __future__ import annotations

import dataclasses
from typing import Final

from rlgcomp.physics.mechanism import Mechanism

STEP: Final = "bias_step_deg_h"
PARTLY: Final = "in_part"


@dataclasses.dataclass(frozen=True)
class BiasStep:
    """One step of the bias in one run.

    Parameters
    ----------
    run : int
        Among the training runs.
    at_s : float
        By that run's clock.
    after : bool
        What comes after is apart from other runs; else what was before.
    probability : float
        That there is one.
    """

    run: int
    at_s: float
    after: bool
    probability: float = 1.0

    @property
    def parameter(self) -> str:
        """Its name among what is free."""
        return f"{STEP}_at_{self.at_s:.0f}_s"


@dataclasses.dataclass(frozen=True)
class Partly:
    """A cause that acts in a part of the training runs.

    Parameters
    ----------
    mechanism : Mechanism
        Of one column.
    runs : tuple of int
        In which it acts from beginning to end.
    moment : BiasStep, optional
        In one more run it acts after some moment, or before.
    probability : float
        That it is so.
    """

    mechanism: Mechanism
    runs: tuple[int, ...]
    moment: BiasStep | None = None
    probability: float = 1.0
