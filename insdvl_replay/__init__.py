"""Replay a dive through two navigation filters and say whether the change really helped.

This page is the vocabulary. After it any module can be read.

Frames
------
n : north-east-down, at the vehicle
b : body of the vehicle, forward-starboard-down; the IMU's place and axes
d : DVL, forward-starboard-down of the instrument; turned from b by the mounting rotation
e : Earth; i : inertial

Names
-----
``velocity_n`` is a vector in frame n. ``mat_nb`` takes coordinates in b to coordinates in n.
``specific_force_b`` [m/s^2] is what accelerometers feel (a resting IMU reads -g along down).
``angular_rate_b`` [rad/s] is the body's rate against inertial space, what gyros feel.
``time_ns`` is int64 nanoseconds of validity on the log's clock; ``time_s`` is float seconds from the dive's start.
``position`` is latitude [rad], longitude [rad], height above the ellipsoid [m], in this order.
Units stand in names where a name leaves them open (``lever_arm_m``); everything inside is SI.
Upper case is only for the filter's matrices F G H K P Q R S.

Shapes
------
Rows are times: ``velocity_n`` of k times is (k, 3), ``mat_nb`` is (k, 3, 3). The error state has 12 entries, see
`states`.

Signs
-----
Errors are estimated minus true; innovations are predicted minus measured.
The misalignment phi is in n, with ``mat_nb_estimated = (I + [phi x]) mat_nb_true``.
Biases are what remains in the readings: ``reading = true + bias``.
What is missing is NaN with a word that says why, never 0.
"""

from insdvl_replay.core.version import __version__

TYPE_CHECKING = False  # as in `typing`, whose import would delay the handling of signals
if TYPE_CHECKING:
    from typing import Any

    from insdvl_replay.api import (
        Candidate,
        CommandResult,
        DiveResult,
        DiveResults,
        Result,
        Solution,
        UserMeasurement,
        UserNoise,
        UserReadings,
        calibrate,
        check,
        compact_lake,
        compare,
        compare_settings,
        compare_trajectories,
        demo,
        history,
        inspect,
        load_config,
        merge,
        plan,
        propose,
        read_result,
        read_results,
        replay_log,
        run_as_program,
        run_shard,
        simulate,
    )

__all__ = [
    "Candidate",
    "CommandResult",
    "DiveResult",
    "DiveResults",
    "Result",
    "Solution",
    "UserMeasurement",
    "UserNoise",
    "UserReadings",
    "__version__",
    "calibrate",
    "check",
    "compact_lake",
    "compare",
    "compare_settings",
    "compare_trajectories",
    "demo",
    "history",
    "inspect",
    "load_config",
    "merge",
    "plan",
    "propose",
    "read_result",
    "read_results",
    "replay_log",
    "run_as_program",
    "run_shard",
    "simulate",
]

_API = "insdvl_replay.api"
# What the class of a user imports has modules of its own, since it is loaded anew by each process that runs the class.
_MODULES = {
    "Candidate": "insdvl_replay.nav.user_candidate",
    "Solution": "insdvl_replay.nav.user_candidate",
    "UserMeasurement": "insdvl_replay.nav.user_measurement",
    "UserNoise": "insdvl_replay.nav.user_measurement",
    "UserReadings": "insdvl_replay.nav.user_measurement",
    "run_as_program": "insdvl_replay.preparation.user_process",
}


def __getattr__(name: str) -> "Any":
    """Load the public names when they are asked for: whoever wants help on a command must not wait for numpy."""
    if name in __all__:
        from importlib import import_module

        return getattr(import_module(_MODULES.get(name, _API)), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Name the public names, without loading them."""
    return __all__
