"""Diagnoses of the same runs with other outputs: what does not depend on the output is computed once."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.case import Case
from rlgcomp.diagnosis.diagnose import request_of
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.screen import KEPT_BY_REPEATED, Layout
from rlgcomp.diagnosis.forms.terms import Region
from rlgcomp.diagnosis.prepare import AnySimulator, Prepared
from rlgcomp.diagnosis.search.beam import Search
from rlgcomp.numerics.compiled import one_blas_thread
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Repeated:
    """Diagnoses of the same runs with this and that added to the output.

    Free shapes of the simulator stay calibrated to the runs as they are, and are free to the first order.

    Parameters
    ----------
    bank : Bank
    regions : tuple of Region
    layout : Layout
    """

    bank: Bank
    regions: tuple[Region, ...]
    layout: Layout

    @classmethod
    @one_blas_thread
    def of(
        cls,
        simulator: AnySimulator,
        train: Sequence[Recording],
        *,
        gyro: str | None = None,
        mechanisms: Mapping[str, type[Mechanism]] = CATALOGUE,
    ) -> Self:
        """Of some runs; parameters as of :func:`diagnose`."""
        runs = Prepared.of(simulator, None, train, [], [], gyro=gyro, output=None)
        request = request_of(runs, mechanisms, gyro, None, None)
        bank, regions, _ = Case(runs, mechanisms, request, gyro).question(runs.train)
        layout = Search(bank, regions).layout
        layout.keep(KEPT_BY_REPEATED)
        return cls(bank, tuple(regions), layout)

    @one_blas_thread
    def posterior(self, time_s: Sequence[Array], added: Sequence[Array]) -> Posterior:
        """The posterior of all sets with something added.

        Parameters
        ----------
        time_s, added : sequence of ndarray
            Times in the runs' own, and what is added there in deg/h, of each run.
        """
        runs = []
        for run, at, values in zip(self.bank.data.runs, time_s, added, strict=True):
            more = run.means(run.on_bins_of_rows(np.interp(run.recording.time_s, at, values)))
            runs.append(dataclasses.replace(run, output=run.output + more))
        data = dataclasses.replace(self.bank.data, runs=tuple(runs))
        return Posterior.of(self.bank.with_output(data), self.regions, self.layout)
