"""Whether the columns of a dive can be what its log says; files are never touched here.

`plausibility` asks everybody: `imu`, `dvl` and `reference` look at one sensor each, the others hold two beside each
other.
"""
