"""From histories to tables and verdicts: pure functions; `evaluate` fills all tables of a dive.

Each chapter builds on those above it: `series` has the statistics, `reference_errors`, `convergence`, `drift`,
`consistency`, `credibility` and `outage_test` the tables, `evidence` compares each candidate with the baseline,
`verdicts` puts that in words, for one dive or several, `notes` has the hints on settings and what the reference does
not see, and `ensemble` is for Monte Carlo studies. The definitions are those of docs/equations/tables.md and
judgement.md; the columns are part of the tool's contract.
"""
