"""From histories to tables: what a filter believes, what the reference says, and whether the two agree.

Pure functions. Their definitions are those of equations/tables.md; the columns are part of the tool's contract.
"""
