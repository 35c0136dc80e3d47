"""Whether the columns of a dive can be what its log says; no file is read here.

`imu` and `dvl` look at one instrument each, `reference` compares them with the reference, `sensors` looks at the rest.
An error ends the work where the tables would be wrong; a warning says what may be wrong. Both name the key that helps.
"""
