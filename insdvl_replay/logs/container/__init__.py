"""An MCAP file, a bag or several files: which channels they have, and their messages as blocks of bytes.

`mapped_file` gives the bytes, `records` stand in them; `scanner` walks over these, and `mcap_index` holds what it finds
against the file's own summary. `chunks` are opened and checked, and the messages in them found as `blocks`, which
`mcap_file` gives to who reads them. What is not as the format says is `damage`, and `loss` counts what it took.
`recording` says which of all this a path stands for.
"""
