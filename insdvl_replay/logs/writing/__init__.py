"""Columns to a log: MCAP with the profile ``ros2``.

`messages` say which column fills which field, `writer` serialises them, `log_file` writes the container.
`dive_log` and `replay_log` say what stands in a dive and in the result of a replay.
"""
