"""The names of this chapter."""

from insdvl_replay.evaluation.curves import CoastingCurve as OutageCurve
from insdvl_replay.evaluation.curves import ConvergenceCurves, Curves, curves_of
from insdvl_replay.evaluation.judging import (
    judged_candidates,
    judged_times,
    reference_notes,
    tables_of_filters,
    with_solutions,
)

__all__ = [
    "ConvergenceCurves",
    "Curves",
    "OutageCurve",
    "curves_of",
    "judged_candidates",
    "judged_times",
    "reference_notes",
    "tables_of_filters",
    "with_solutions",
]
