"""The other halls: studies that join the simulation, logs, filters and evaluation the way `replay` does.

`montecarlo` asks whether filters are as good as they say where the truth is known.
"""
