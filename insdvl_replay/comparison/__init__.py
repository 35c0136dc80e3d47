"""Two sets of results laid beside each other, dive by dive and cell by cell.

`comparison` joins the steps, `document` lays it out.
"""
