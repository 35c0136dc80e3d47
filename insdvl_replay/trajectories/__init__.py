"""Any trajectories against a reference, by the rule of a verdict: no DVL and no replay is needed.

`files` finds which files are runs of which dive. `tracks` reads them and brings them to common times. `dive_evidence`
compares two filters on one dive, and `comparison` all dives. `document` shows it.
"""
