"""Whether the columns of a dive can be what its log says; files are never touched here.

`plausibility` asks everybody: `imu`, `dvl` and `reference` look at one sensor each, beside what others say of it.
"""
