"""One way to hold an analytic Jacobian against finite differences."""

from collections.abc import Callable

import numpy as np

from insdvl_replay.core.dive_columns import Floats


def assert_jacobian(
    analytic: Floats,
    function: Callable[[Floats], Floats],
    x: Floats,
    atol: float,
    step: float | Floats = 1e-6,
) -> None:
    """Compare with central differences of ``function`` at ``x``."""
    steps = np.broadcast_to(step, x.shape)
    columns = []
    for index in range(len(x)):
        forth, back = x.copy(), x.copy()
        forth[index] += steps[index]
        back[index] -= steps[index]
        columns.append((function(forth) - function(back)) / (2.0 * steps[index]))
    np.testing.assert_allclose(analytic, np.stack(columns, axis=-1), rtol=0.0, atol=atol)
