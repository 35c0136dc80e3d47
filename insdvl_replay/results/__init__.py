"""The result folder, as it is stored and read again. It draws no page.

`folder` lets results appear all at once or not at all and adds them to a lake, `stored_results` finds them again,
`frames` has histories as data frames, and `trajectory` the filters once a second.
"""
