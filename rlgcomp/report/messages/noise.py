"""Messages of noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final


def _angle_outliers(
    *, run: str, gyro: str, places: int, first_s: float, step_arcsec: float, step_sd: float, left_out_s: float
) -> str:
    where = f"at {first_s:.6g} s" if places == 1 else f"in {places} places, first at {first_s:.6g} s"
    return (
        f"{run}, {gyro}: the angle jumps {where}, by {step_arcsec:.3g} arcsec, {step_sd:.0f} standard deviations of its noise: a "
        f"shock or a fault of the logger; {left_out_s:.2g} s around are left out."
    )


TEXTS: Final[dict[str, str | Callable[..., str]]] = {
    "noise.angle_outliers": _angle_outliers,
}
