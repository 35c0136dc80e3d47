"""The result folder, as it is stored and read again. It draws no page.

`folder` lets results appear all at once or not at all, `stored_results` finds them again, `lake` keeps the evidence of
many replays, `frames` has histories as data frames, and `trajectory` the filters once a second.
"""
