"""What a log holds, whether it can be replayed, and settings to start from where it cannot.

`survey` counts, joins the rest and lays it out: `dry_run` reads what a replay would read, `proposal` looks for
settings by names and values, and `settings` writes them. `automatic` finds the rest by trials and calibration.
"""
