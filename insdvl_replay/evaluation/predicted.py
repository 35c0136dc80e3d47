"""The names of this chapter."""

from insdvl_replay.evaluation.believed import mean_over_nine, nearest_over_nine

__all__ = ["mean_over_nine", "nearest_over_nine"]
