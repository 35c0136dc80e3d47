"""Two sets of results laid beside each other, dive by dive and cell by cell.

`comparison` joins the steps: `dive_matching` and `filter_pairs` say what is compared with what, `aggregation` gathers
cells over dives, `fail_on` finds what is worse than allowed. `document` lays it out, with tables of `display_tables`.
"""
