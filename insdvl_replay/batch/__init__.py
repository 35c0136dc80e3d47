"""Many dives: which are meant (`dive_paths`), which have to be replayed (`known_results`), and their replay (`jobs`).

`workers` hand out the work, and do it here; `cluster` has workers elsewhere. `noise_tuning` adds the tuned baseline.
"""
