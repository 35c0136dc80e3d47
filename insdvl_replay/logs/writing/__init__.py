"""Columns to a log: MCAP with the profile ``ros2``.

`writer` says which column fills which field and serialises them, `log_file` writes the container.
`dive_log` and `replay_log` say what stands in a dive and in the result of a replay.
"""
