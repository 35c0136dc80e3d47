"""From histories to tables and verdicts: pure functions; `evaluate` fills all tables of a dive.

Each chapter builds on those above it. `series` counts independent samples and compares two filters' errors over one
dive or several; `chi_square` judges means of squares. `predicted` has what P says of improvement, `errors` those
against the reference, `convergence` when both settle, `drift` errors over segments, track fits and jumps, `consistency`
the innovations, `credibility` errors in the filter's own standard deviations, `outage_test` the drift without DVL.
`evidence` compares each candidate with the baseline, piece by piece, `verdicts` puts that in words, `over_dives` pools
several dives, and `ensemble` has the runs of a Monte Carlo study.

The definitions are those of equations/tables.md and equations/judgement.md. The columns are part of the contract.
"""
