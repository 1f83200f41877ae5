"""Cases of all kinds, each made of its plan."""

from __future__ import annotations

from experiments.concealed.bench import chamber_case
from experiments.concealed.case import Case
from experiments.concealed.plan import Plan
from experiments.concealed.turning import turntable_case


def make_case(plan: Plan) -> Case:
    """The case that is planned."""
    return turntable_case(plan) if plan.kind == "turntable" else chamber_case(plan)
