"""By what a replay shows that its settings do not fit the dive. Nothing here needs the filters."""

from typing import Final

from insdvl_replay.core.errors import LogError

# mean NIS/dof of a baseline whose settings fit the dive
LEAST_NIS: Final = 0.4
MOST_NIS: Final = 2.5
# Share of the velocities that such a baseline rejects at most; one that diverges rejects several in a row each time.
MOST_REJECTED: Final = 0.02
# Warnings that name a unit, axes, a sign or a scale that is wrong.
MISREAD: Final = frozenset(
    {
        "imu_gravity",
        "imu_upside_down",
        "imu_gyro_sign",
        "imu_gyro_scale",
        "imu_gyro_contradiction",
        "imu_gyro_axis",
        "imu_turned",
        "dvl_direction",
        "dvl_axes",
        "dvl_scale",
        "dvl_contradiction",
        "track_contradiction",
    }
)


class MisfitError(LogError):
    """The settings do not fit the dive, so that its filters would say nothing."""
