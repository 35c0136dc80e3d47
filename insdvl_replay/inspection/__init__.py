"""What a log holds, whether it can be replayed, and settings to start from where it cannot.

`survey` counts and joins the rest: `dry_run` reads what a replay would read, `proposal` looks for settings, for
which `topic_probe` sees what unknown topics show. `inventory` is the result as data, `document` lays it out.
"""
