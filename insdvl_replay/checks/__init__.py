"""Plausibility checks of the columns of a dive; no file is read here.

`imu` and `dvl` check one instrument each, `reference` compares them with the reference, `sensors` checks the rest.
An error stops the replay where the tables would be wrong. A warning reports what may be wrong. Both name a key to set.
"""
