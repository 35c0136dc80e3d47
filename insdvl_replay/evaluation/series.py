"""The names of this chapter."""

from insdvl_replay.evaluation.effective_samples import samples_in_mean, samples_in_mean_square
from insdvl_replay.evaluation.paired_statistics import dives_ratio, what_settles, windows_ratio

__all__ = ["dives_ratio", "samples_in_mean", "samples_in_mean_square", "what_settles", "windows_ratio"]
