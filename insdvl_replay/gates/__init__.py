"""What must hold of a dive's tables: `gate_file` reads gates, `checking` holds dives against them, `findings` cells.

`model` is gates and what became of them as data; `output` writes it.
"""
