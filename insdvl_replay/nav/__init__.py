"""The mathematics: strapdown mechanisation, DVL, error model, measurements, Kalman filter. Numpy and numba only.

`filter.run_filter` joins the chapters: `timeline` orders the events, `strapdown` moves the state, `error_model`
propagates P, `measurements` predicts readings, `kalman` updates P and corrects the state. `outage.run_outage` continues
from a ping without the next ones. docs/equations maps every equation to its function and its test.
"""
