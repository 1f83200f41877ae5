"""What happens in some of the runs alone, as a problem takes it in: a step of the bias, a cause that acts in a part of the runs."""

from __future__ import annotations

import dataclasses
import math
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
    log_odds : float
        Logarithm of the odds that there is one.
    """

    run: int
    at_s: float
    after: bool
    log_odds: float = math.inf

    @property
    def probability(self) -> float:
        """That there is one."""
        return probability_of(self.log_odds)

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
    log_odds : float
        Logarithm of the odds that it is so.
    """

    mechanism: Mechanism
    runs: tuple[int, ...]
    moment: BiasStep | None = None
    log_odds: float = math.inf

    @property
    def probability(self) -> float:
        """That it is so."""
        return probability_of(self.log_odds)


def probability_of(log_odds: float) -> float:
    """Of odds.

    >>> probability_of(0.0), probability_of(math.inf), probability_of(-math.inf)
    (0.5, 1.0, 0.0)
    """
    return 1.0 / (1.0 + math.exp(min(700.0, -log_odds))) if log_odds > -700.0 else 0.0
