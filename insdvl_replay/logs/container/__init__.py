"""An MCAP file, a bag or several files: which channels they have, and their messages as blocks of bytes.

`mapped_file` gives the bytes, `scanner` walks over them and `mcap_index` holds what it finds against the file's own
summary; `chunks` are opened and checked, `chunk_messages` finds the messages in them, and `chunk_reader` does both
ahead of who reads them. What is not as the format says is `damage`, and `loss` counts what it took. `recording` says
which of all this a path stands for.
"""
