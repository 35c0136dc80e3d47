"""Messages become the clean columns of the roles: SI units, the project's axes, every loss counted.

`known_types.toml` says which field of a message holds what. `topics` finds the topic of a role. `tables` reads its
messages and compares their clocks. `clean` puts them in order, and drops what cannot be used. `imu`, `dvl`,
`reference` and `sensors` know what a role needs and what its numbers mean; `logs.read` joins them.
"""
