"""Laws of a column that changes its sign: a step with the sign (Coulomb friction), odd and even functions about zero."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.bases import Basis, Power, Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.terms import Family

Array = npt.NDArray[np.float64]
_WIDTHS: Final = (0.005, 0.015, 0.05)  # of a step
_RATIO: Final = 3.0  # from one to the next
_OFF_CENTRE: Final = 0.5  # halves of the range by which its middle may be off zero


@dataclasses.dataclass(frozen=True)
class Sign(Basis):
    r"""Sign of a recorded column, :math:`\tanh(u / w)` where it changes over a width w.

    It is evaluated at each sample, and averaged over bins afterwards: the sign of a mean is another.
    """

    driver: Driver
    width: float = 0.0  # of the driver's largest size

    def columns(self, run: Run) -> Array:
        (column,) = self.driver.columns
        values = run.recording.column(column) / self.driver.half
        return run.on_bins_of_rows(np.tanh(values / self.width) if self.width else np.sign(values))[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        factors = (_RATIO**step, _RATIO**-step) if self.width else ()
        return tuple(dataclasses.replace(self, width=self.width * factor) for factor in factors)

    def parameters(self) -> dict[str, float]:
        return {"w": self.width * self.driver.half} if self.width else {}


def about_zero(driver: Driver) -> Driver | None:
    """A driver in units of its largest size, zero staying zero; None where the column hardly changes its sign."""
    if abs(driver.centre) > _OFF_CENTRE * driver.half:
        return None
    return dataclasses.replace(driver, centre=0.0, half=abs(driver.centre) + driver.half)


def symmetric_laws(driver: Driver, kin: Sequence[Basis]) -> list[Family]:
    """Families of laws of a column that changes its sign; none of another.

    Parameters
    ----------
    driver : Driver
    kin : sequence of Basis
        Departures of the driver's laws.
    """
    centred = about_zero(driver)
    if centred is None:
        return []
    symbol, path, sign = centred.symbol, Path(centred), Sign(centred)
    odd, even = Smooth(path, parity=-1), Smooth(path, parity=1)
    wide, kin = [Sign(centred, width) for width in _WIDTHS], (*kin, Smooth(path, 0.15, 20))
    return [
        Family(f"b = c sign({symbol})", [(sign,)], kin),
        Family(f"b = c tanh({symbol} / w)", [(one,) for one in wide], kin),
        Family(f"b = c sign({symbol}) + k {symbol}", [(sign, Power(path))], kin),
        Family(f"b = c tanh({symbol} / w) + k {symbol}", [(one, Power(path)) for one in wide], kin),
        Family(f"b = odd function of {symbol}", [(Power(path), odd)], ()),
        Family(f"b = even function of {symbol}", [(even,)], ()),
    ]
