"""From settings and columns to what the filters need, before they run.

`prepared` does all of it for a dive; `alignment` says where its filters start, `aiding` what each of them measures and
how large its noise is.
"""
