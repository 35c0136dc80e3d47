"""What every room speaks of, and what the program runs on.

`columns` and `history` are what goes into filters and comes out, `dive_record` what a dive is called, `config` the
settings, `errors` what is wrong and noted, `states` the 12 error states, `tables` the rows of a result and `words` its
verdicts. `compiled` keeps machine code, `runtime` knows memory, threads and progress, `plain_text` makes
text harmless.
"""
