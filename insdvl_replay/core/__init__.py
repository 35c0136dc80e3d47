"""What everything else speaks of, and what the program runs on.

`dive_columns` and `history` are what goes into filters and comes out, `dive_record` what a dive is called, `config` the
settings and `config_file` their TOML, `errors` what is wrong and noted, and text made harmless, `states` the error
states, sensors and units, `tables` the rows of a result, `words` its verdicts and `report` its file. `runtime` knows
compiled code, threads, memory and progress.
"""
