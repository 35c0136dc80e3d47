"""From histories to tables: what a filter believes, what the reference says, and whether the two agree.

`judging` fills all tables of a dive: `believed` (improvement and convergence by the filter's own covariance),
`reference` (errors), `consistency` (NIS, which `chi_square` judges), `credibility` (NEES). `coasting` says how far
filters drift while the velocities are withheld from them, which needs no reference.

`evidence` holds each candidate against the baseline, piece by piece: `losses` against the reference (`drift` over
segments, velocities along and across the track) from drawn starts, whose runs `drawn_errors` gathers; coasting; and
`measured_convergence`. `paired_statistics` compares two filters' losses over one dive, and ratios over several, with
intervals and a word; `pooled_evidence` does so for all pieces. `verdicts` puts the evidence in words, `sound_filters`
says of which filters nothing is to be said. `coverage` says what the reference does not see.

Pure functions. Their definitions are those of equations/tables.md; the columns are part of the tool's contract.
"""
