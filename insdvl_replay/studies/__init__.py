"""Studies, which join the simulation, logs, filters and evaluation the way `replay` does.

`montecarlo` asks whether filters are as good as they say where the truth is known, `window` how many past velocities
make the best acceleration, `observability` which errors the measurements of a dive cannot tell apart.
"""
