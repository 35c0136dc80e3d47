"""From a log and settings to runs of every candidate, and their verdicts.

`replay` is one screen: how a dive becomes a verdict. `prepared` reads and checks a dive, settles long gaps of the IMU,
and does what else comes before the filters: `alignment` finds the start, `filters` what each filter measures, `plugins`
what user code measures. `run` runs the candidates, among them recorded `solutions`. All `notes` are in one table.
"""
