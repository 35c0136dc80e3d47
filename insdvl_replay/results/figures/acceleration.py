"""What the second measurement is worth: the slope of the DVL's velocities beside the reference's acceleration."""

from typing import Final

from insdvl_replay.core.columns import Floats, TimeNs
from insdvl_replay.report.plots.panel import REFERENCE, Curve, Figure, Panel
from insdvl_replay.results.figures.clock import Clock

DERIVED: Final = "derived"
_AXES: Final = ("forward", "starboard", "down")


def acceleration_figure(
    time_ns: TimeNs, derived_b: Floats, reference_b: Floats | None, clock: Clock, *, lever_arm: bool
) -> Figure:
    """Draw both accelerations over time, one panel for each axis of the body.

    Parameters
    ----------
    time_ns : ndarray, shape (m,)
        Times of validity.
    derived_b, reference_b : ndarray, shape (m, 3)
        m/s^2; the reference's, if there is one that gives any.
    clock : Clock
    lever_arm : bool
        Whether the DVL lies away from the IMU.

    Returns
    -------
    Figure
    """
    swing = " The swing of the DVL about the IMU is left in." if lever_arm else ""
    legend = [(DERIVED, "slope of the DVL's velocities")]
    if reference_b is not None:
        legend.append((REFERENCE, "derivative of the reference's velocity"))
    return Figure(
        "What the acceleration is worth: from the DVL, beside the reference",
        f"Rates of the velocity's components in body axes, at the middle of their windows.{swing}",
        tuple(_panel(axis, time_ns, derived_b, reference_b, clock) for axis in range(3)),
        tuple(legend),
    )


def _panel(axis: int, time_ns: TimeNs, derived_b: Floats, reference_b: Floats | None, clock: Clock) -> Panel:
    curves = [Curve(clock.time(time_ns), derived_b[:, axis], DERIVED)]
    if reference_b is not None:
        curves.append(Curve(clock.time(time_ns), reference_b[:, axis], REFERENCE))
    return Panel(f"acceleration {_AXES[axis]} [m/s²]", clock.label, tuple(curves))
