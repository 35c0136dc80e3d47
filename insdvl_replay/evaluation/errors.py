"""The names of this chapter."""

from insdvl_replay.evaluation.acceleration import (
    acceleration_at,
    differentiated_over_s,
    reference_acceleration,
    vector_rmse,
)
from insdvl_replay.evaluation.coverage import WELL_COVERED, covered_share
from insdvl_replay.evaluation.drawn_errors import (
    DrawnErrors,
    RunFromStart,
    drawn_errors,
    run_from_start,
    squared_errors,
)
from insdvl_replay.evaluation.reference import ReferenceErrors, attitude_error, reference_errors
from insdvl_replay.evaluation.state_errors import motion_error

__all__ = [
    "WELL_COVERED",
    "DrawnErrors",
    "ReferenceErrors",
    "RunFromStart",
    "acceleration_at",
    "attitude_error",
    "covered_share",
    "differentiated_over_s",
    "drawn_errors",
    "motion_error",
    "reference_acceleration",
    "reference_errors",
    "run_from_start",
    "squared_errors",
    "vector_rmse",
]
