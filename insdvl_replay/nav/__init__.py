"""The mathematics: strapdown mechanisation, DVL, error model, measurements, Kalman filter. Numpy and numba only.

`filter.run_filter` joins the chapters; equations/ maps every equation to its function and its test.
"""
