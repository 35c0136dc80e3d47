"""From readings of an IMU to what they add up to over an interval: a turn, and a change of the velocity.

Readings are instantaneous. Beside their mean, three terms make the sums exact to the fourth order of the interval:

- the bend of the readings between samples, since straight lines cut the crests of a wave;
- coning: turns about an axis that itself turns do not simply add up;
- sculling: forces that swing in step with turns leave a mean.

Sources: Savage, parts 1 and 2, for coning and sculling; Magnus for their order; see docs/equations/mechanisation.md.
"""

from typing import Final, NamedTuple

from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.algebra import Vector, add, cross, scale, subtract

UNEVEN: Final = 4.0
"""Where one step is so many times as long as the next, a sample was lost or several were. A bend that is found there
would be the noise of the shorter step."""


class Readings(NamedTuple):
    """What an IMU reads at one time, and how the readings bend there."""

    specific_force_b: Vector  # m/s^2
    angular_rate_b: Vector  # rad/s
    force_bend_b: Vector  # half the second derivative, m/s^4
    rate_bend_b: Vector  # rad/s^3


class Increments(NamedTuple):
    """What readings add up to over an interval."""

    mean_force_b: Vector  # m/s^2, to be turned to n by the mean of the attitudes at both ends
    turn_b: Vector  # rotation vector of b, rad


@inlined
def bend_weights(before_s: float, after_s: float) -> tuple[float, float]:
    """Return the weights of the steps to a sample and from it on in the bend there, of a parabola through the three.

    The bend is the second weight times the second step less the first weight times the first.

    Parameters
    ----------
    before_s, after_s : float
        Time from the sample before, and to the next one, s.
    """
    if before_s > UNEVEN * after_s or after_s > UNEVEN * before_s:
        return 0.0, 0.0
    share = 1.0 / (before_s * after_s * (before_s + after_s))
    return share * after_s, share * before_s


@inlined
def readings_between(before: Readings, after: Readings, into_s: float, step_s: float) -> Readings:
    """Return the readings ``into_s`` after the start of an interval of ``step_s``: on the cubic with these bends."""
    share = into_s / step_s
    return Readings(
        _between(
            before.specific_force_b,
            after.specific_force_b,
            before.force_bend_b,
            after.force_bend_b,
            into_s,
            step_s,
        ),
        _between(
            before.angular_rate_b,
            after.angular_rate_b,
            before.rate_bend_b,
            after.rate_bend_b,
            into_s,
            step_s,
        ),
        _on_line(before.force_bend_b, after.force_bend_b, share),
        _on_line(before.rate_bend_b, after.rate_bend_b, share),
    )


@inlined
def _between(
    before: Vector,
    after: Vector,
    bend_before: Vector,
    bend_after: Vector,
    into_s: float,
    step_s: float,
) -> Vector:
    share = into_s / step_s
    bend = _on_line(bend_before, bend_after, (1.0 + share) / 3.0)
    return add(_on_line(before, after, share), scale(into_s * (into_s - step_s), bend))


@inlined
def _on_line(before: Vector, after: Vector, share: float) -> Vector:
    return add(before, scale(share, subtract(after, before)))


@inlined
def increments(
    before: Readings, after: Readings, accel_bias_b: Vector, gyro_bias_b: Vector, dt: float
) -> Increments:
    """Sum up readings over an interval of ``dt`` seconds without a sample inside; the biases are taken off here."""
    mean_rate_b = subtract(
        _mean(
            before.angular_rate_b, after.angular_rate_b, before.rate_bend_b, after.rate_bend_b, dt
        ),
        gyro_bias_b,
    )
    mean_force_b = subtract(
        _mean(
            before.specific_force_b,
            after.specific_force_b,
            before.force_bend_b,
            after.force_bend_b,
            dt,
        ),
        accel_bias_b,
    )
    rate_change = subtract(after.angular_rate_b, before.angular_rate_b)
    force_change = subtract(after.specific_force_b, before.specific_force_b)
    coning = cross(mean_rate_b, rate_change)
    # The mean of the attitudes at both ends makes a steady force too small, by what is taken off its change here.
    steady = scale(dt, cross(mean_rate_b, mean_force_b))
    sculling = subtract(
        cross(mean_rate_b, subtract(force_change, steady)), cross(rate_change, mean_force_b)
    )
    return Increments(
        add(mean_force_b, scale(dt / 12.0, sculling)),
        scale(dt, add(mean_rate_b, scale(dt / 12.0, coning))),
    )


@inlined
def _mean(
    before: Vector, after: Vector, bend_before: Vector, bend_after: Vector, dt: float
) -> Vector:
    return subtract(
        scale(0.5, add(before, after)), scale(dt * dt / 12.0, add(bend_before, bend_after))
    )
