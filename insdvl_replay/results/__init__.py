"""The result folder, written and read.

`result_files` writes all of a replay, `folder` lets it appear all at once or not at all and adds it to a lake,
`stored_results` finds results again, and `trajectory` has the filters once a second.
"""
