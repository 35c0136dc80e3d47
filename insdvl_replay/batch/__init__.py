"""Many dives: which are meant (`dive_paths`), which have to be replayed (`jobs`), and where the work is done.

`executors` hand out the work, `worker_processes` are workers here, `cluster` has those elsewhere.
"""
