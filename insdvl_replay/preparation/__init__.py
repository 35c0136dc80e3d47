"""From a log and settings to what the filters need, before they run.

`reading` reads a dive and has its columns checked, `prepared` does the rest for it; `alignment` finds where its filters
start, `long_gaps` what becomes of gaps, and `filters` what each of them measures and how large its noise is.
"""
