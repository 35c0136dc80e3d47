"""The mathematics: strapdown mechanisation, DVL, error model, measurements, Kalman filter. Numpy and numba only.

`filter.run_filter` joins the chapters: `timeline` orders the events, `strapdown` moves, `error_model` propagates P,
`measurements` are prepared and `innovation` linearises them, lever arm included, `kalman` updates, and `correction`
takes the errors out. `coasting` goes on from a ping without the next ones. equations/ maps every equation to its
function and its test.
"""
