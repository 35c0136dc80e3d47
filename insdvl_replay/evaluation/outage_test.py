"""The names of this chapter."""

from insdvl_replay.evaluation.coasting import Coast as OutageRun
from insdvl_replay.evaluation.coasting import Coasts as OutageRuns
from insdvl_replay.evaluation.coasting import DriftOverTime, distance_along_m, window_ends
from insdvl_replay.evaluation.coasting import coast_of as outage_run
from insdvl_replay.evaluation.coasting import coasting_table as outage_test_table
from insdvl_replay.evaluation.coasting_windows import SHOWN_EVERY_S, SHOWN_S
from insdvl_replay.evaluation.coasting_windows import CoastingPlan as OutagePlan
from insdvl_replay.evaluation.coasting_windows import plan_coasting as plan_outages

__all__ = [
    "SHOWN_EVERY_S",
    "SHOWN_S",
    "DriftOverTime",
    "OutagePlan",
    "OutageRun",
    "OutageRuns",
    "distance_along_m",
    "outage_run",
    "outage_test_table",
    "plan_outages",
    "window_ends",
]
