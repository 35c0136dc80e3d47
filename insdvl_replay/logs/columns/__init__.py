"""Messages to the clean columns of those who play a role: SI units, the project's axes, every loss counted.

`known_types`, `known_dvls` and `known_sensors` say which field of a message holds what; `roles` chooses topics by the
`topic_requirements`, `table_reading` fills their `tables`, `cleaning` puts rows into the `order` of time, and `imu`,
`dvl` with `beam_directions`, and `reference` make of these the columns of IMU, DVL and reference.
"""
