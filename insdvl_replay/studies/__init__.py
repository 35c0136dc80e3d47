"""Studies with simulation, logs, filters and evaluation.

`montecarlo` checks the consistency of filters against a known truth. `window` finds the number of past velocities for
the best acceleration. `observability` finds the errors that the measurements of a dive cannot observe.
"""
