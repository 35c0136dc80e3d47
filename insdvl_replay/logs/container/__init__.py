"""A log, a bag or several files: which channels they have, and their messages as blocks of bytes.

`opening` tells by the first bytes which kind of `log_file` one is: `mcap_file`, `sqlite_file` for the .db3 of ROS 2, or
`bag_file` for ROS 1, whose `bag_records` are another format. `recording` says which of all this a path stands for.

Of MCAP, `mapped_file` gives the bytes, `records` stand in them, or damage; `scanner` walks over these, and holds what
it finds, the `mcap_index`, against the file's own summary. `chunks` are opened and checked, and the messages in them
found as `blocks`, which `mcap_file` gives to who reads them; `loss` counts what damage took.
"""
