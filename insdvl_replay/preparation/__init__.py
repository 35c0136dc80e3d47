"""From a log and settings to runs of every candidate.

`prepared` reads and checks a dive, and does what comes before the filters: `gaps` settles pauses of the IMU,
`alignment` finds the start, `filters` what each filter measures, `plugins` what user code measures. `run` runs the
candidates, among them recorded `solutions`.
"""
