"""From histories to tables: what a filter believes, what the reference says, and whether the two agree.

`judging` fills all tables of a dive: `believed` (improvement and convergence by the filter's own covariance),
`reference` (errors), `consistency` (NIS, which `chi_square` judges), `credibility` (NEES). `verdicts` puts them in
words, `coverage` says what the reference does not see, `row_changes` what a stored table's cells became.

Pure functions. Their definitions are those of equations/tables.md; the columns are part of the tool's contract.
"""
