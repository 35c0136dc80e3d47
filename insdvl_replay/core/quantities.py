"""What the rows of the tables are about: the names of states and quantities, and which words are best."""

from typing import Final, NamedTuple

from insdvl_replay.core.held_out import held_out_name, held_out_sensor
from insdvl_replay.core.states import AIDING, AXES_N, BA, BG, DV, PHI, POSITION, SENSORS, STATES
from insdvl_replay.core.words import Consistency, Verdict

# On a filter's consistency; ``insufficient data`` says nothing of it and has no rank.
VERDICTS_BEST_FIRST: Final = (
    Consistency.CONSISTENT,
    Consistency.CONSERVATIVE,
    Consistency.OVERCONFIDENT,
    Consistency.NOT_FINITE,
)

# Of candidates without a verdict: their numbers mean nothing.
WITHOUT_VERDICT: Final = (Verdict.NOT_EVALUATED, Verdict.NOT_REPEATABLE)

# Rows of reference errors and their units; ``position_h_pct`` is of the way by the reference.
REFERENCE_QUANTITIES: Final = {
    "velocity_n": "m/s",
    "velocity_e": "m/s",
    "velocity_d": "m/s",
    "roll": "deg",
    "pitch": "deg",
    "heading": "deg",
    "position_h": "m",
    "depth": "m",
    "position_h_pct": "%",
}
# Rows of credibility in the order of the error state; the attitude about the vehicle's level axes.
CREDIBILITY_QUANTITIES: Final = (
    "velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "heading", *(state.id for state in STATES[BA.start :]),
)  # fmt: skip
# Rows of states that are judged together, with their block of P; the gravest of them stands for the filter.
CREDIBILITY_GROUPS: Final = {
    "velocity": DV,
    "attitude": PHI,
    "accelerometer_bias": BA,
    "gyro_bias": BG,
}
# Further rows of a filter that estimates its position.
POSITION_QUANTITIES: Final = ("position_n", "position_e", "position_d")
ALL_CREDIBILITY_GROUPS: Final = {**CREDIBILITY_GROUPS, "position": POSITION}
# Rows of the baseline after it has settled, by which it is fit to judge by or not; without the heading, which keeps the
# error of the start, of a compass or of the mounting.
SETTLED_PREFIX: Final = "settled_"
SETTLED_VELOCITY: Final = f"{SETTLED_PREFIX}velocity"
SETTLED_LEVEL: Final = f"{SETTLED_PREFIX}level"
SETTLED: Final = (SETTLED_VELOCITY, SETTLED_LEVEL)
# The row of all compared states together, in which small errors of some may hide large ones of others.
JOINT: Final = "all"
AXES: Final = ("x", "y", "z")  # Axes of a measurement in b.
# Of a measurement of the user's own, which may be along no axes.
COMPONENTS: Final = (
    "c1",
    "c2",
    "c3",
    "c4",
)


def axis_of(measurement: str, axis: str) -> str:
    """Name the row that a measurement has for one of its axes."""
    return f"{measurement}_{axis}"


def is_whole(measurement: str) -> bool:
    """Distinguish a whole measurement, which stands for a filter's verdict, from one of its axes, which say where."""
    return not measurement.endswith(
        tuple(axis_of("", axis) for axis in (*AXES, *AXES_N, *COMPONENTS))
    )


# How the four beams of a ping agree: noise that is measured without a filter.
PARITY: Final = "parity"
_BEAM: Final = "beam_"


def is_used(measurement: str) -> bool:
    """Distinguish a whole measurement that a filter predicts and uses, by which it is judged honest or not."""
    is_compared_only = measurement == PARITY or held_out_sensor(measurement) != ""
    return is_whole(measurement) and not is_compared_only


def beam_name(number: int) -> str:
    """Name the measurement by one beam of the DVL, of which there may be more than the usual four."""
    return f"{_BEAM}{number}"


def is_beam(measurement: str) -> bool:
    """Return whether this is one beam of the DVL."""
    return measurement.startswith(_BEAM) and measurement.removeprefix(_BEAM).isdecimal()


# What filters are aided by, each with the names of its components.
MEASUREMENTS: Final[dict[str, tuple[str, ...]]] = {
    "velocity": AXES,
    "acceleration": AXES,
    **{beam_name(number): () for number in range(1, 5)},
    PARITY: (),
    **{name: sensor.components for name, sensor in SENSORS.items()},
    **{held_out_name(name): sensor.components for name, sensor in SENSORS.items()},
}


def is_reserved(measurement: str) -> bool:
    """Return whether the tool gives this name to measurements of its own, which nobody else's may have."""
    of_a_kind = is_beam(measurement) or held_out_sensor(measurement) != ""
    return of_a_kind or measurement in MEASUREMENTS or measurement in AIDING


class Stretch(NamedTuple):
    """The length of the stretches over which a drift is measured."""

    length: float
    unit: str  # s, or m travelled


DRIFT_STRETCHES: Final = {
    "drift_30s": Stretch(30.0, "s"),
    "drift_60s": Stretch(60.0, "s"),
    "drift_100m": Stretch(100.0, "m"),
}
# Stretches over which trajectories are compared that no filter of this tool made.
TRACK_STRETCHES: Final = {
    "drift_10s": Stretch(10.0, "s"),
    "drift_60s": Stretch(60.0, "s"),
    "drift_100s": Stretch(100.0, "s"),
    **{f"drift_{length}m": Stretch(float(length), "m") for length in range(100, 900, 100)},
}
STRETCHES: Final = {**DRIFT_STRETCHES, **TRACK_STRETCHES}
# Errors against the reference.
ACCURACY: Final = (
    *DRIFT_STRETCHES, "velocity_along", "velocity_across", "depth_60s", "level", "heading"
)  # fmt: skip
# Rows of drift and their units: the horizontal position, what it drifts by over stretches, and the velocity.
DRIFT_QUANTITIES: Final = {
    "position_h": "m",
    "drift_60s": "m",
    "drift_100m": "m",
    "velocity_along": "m/s",
    "velocity_across": "m/s",
}
# Rows of the track fit and their units.
TRACK_FIT_QUANTITIES: Final = {
    "scale": "%",
    "turn": "deg",
}
OUTAGE_WINDOWS_S: Final = ("30", "60", "120", "300")  # Lengths for which the DVL is withheld.
_OUTAGE: Final = tuple(f"outage_{window}s" for window in OUTAGE_WINDOWS_S)
# Errors whose convergence is measured, and how `reference_errors.squared_errors` names them.
CONVERGED: Final = {"velocity": "velocity_h", "level": "level", "heading": "phi_d"}
_CONVERGENCE: Final = tuple(f"convergence_{name}" for name in CONVERGED)
# Differences from sensors that are withheld.
HELD_OUT_QUANTITIES: Final = tuple(held_out_name(name) for name in SENSORS)
# How well a filter predicts the DVL, by its log score.
PREDICTION: Final = "prediction"
# Evidence whether innovations and errors are as large as a filter says; it neither decides nor warns.
CONSISTENCY: Final = "consistency"
# Errors of the track of a whole dive: unit, and row and column of the reference errors.
TRACK: Final = {
    "position": ("m", "position_h", "rmse"),
    "position_end": ("m", "position_h", "final"),
    "position_pct": ("%", "position_h_pct", "rmse"),
    "position_end_pct": ("%", "position_h_pct", "final"),
    "depth": ("m", "depth", "rmse"),
}
# The position from a start whose heading errs as the vehicle's own may, where only the reference gave the heading.
DRAWN_HEADING: Final = "position_drawn_heading"
# The quantities that may decide, the first that the logs contain before others.
PRIMARIES: Final = ("position", "outage_60s", "outage_30s")
# All that settings may name instead.
DECIDERS: Final = (*TRACK, *_OUTAGE, *ACCURACY, *HELD_OUT_QUANTITIES)
# Quantities that can warn, by kind; the first of a kind that the dives have stands for it.
SECONDARIES: Final = {
    "outage": ("outage_60s", "outage_30s"),
    "drift": ("drift_60s", held_out_name("position")),
    "level": ("level",),
    "heading": ("heading", held_out_name("heading")),
    "velocity along": ("velocity_along",),
    "velocity across": ("velocity_across",),
}
FEWEST_DIVES: Final = 3  # Fewer dives decide nothing.
# What a vehicle does while it drifts, by which a drift is sorted into bins.
BINS: Final = (
    "straight",
    "turns",
    "hover",
    "climbs",
    "no_bottom_lock",
    "near_bottom",
    "fast",
    "slow",
)
# Rows of evidence, each name once, those that may decide in front.
EVIDENCE_QUANTITIES: Final = (
    *(
        *TRACK,
        DRAWN_HEADING,
        *_OUTAGE,
        *ACCURACY,
        *(name for name in TRACK_STRETCHES if name not in DRIFT_STRETCHES),
        *HELD_OUT_QUANTITIES,
        PREDICTION,
        "position_crps",
        *_CONVERGENCE,
    ),
    *("nis", "nees"),
)
_LABELS: Final = {
    **{state.id: state.label for state in STATES},
    **{f"outage_{window}s": f"DVL outage {window} s" for window in OUTAGE_WINDOWS_S},
    **{name: f"drift in {length:g} {unit}" for name, (length, unit) in STRETCHES.items()},
    "depth_60s": "depth in 60 s",
    "position_n": "position, north",
    "position_e": "position, east",
    "position_d": "position, down",
    "velocity_n": "velocity, north",
    "velocity_e": "velocity, east",
    "velocity_d": "velocity, down",
    "position_h": "position",
    "position_h_pct": "share of distance",
    DRAWN_HEADING: "position, drawn heading",
    "position_end": "position at the end",
    "position_pct": "share of distance",
    "position_end_pct": "share at the end",
    "convergence_velocity": "velocity settled",
    "convergence_level": "level settled",
    "convergence_heading": "heading settled",
    "prediction": "prediction of DVL",
    "position_crps": "position CRPS",
    "nis": "NIS / dof",
    "nees": "NEES / dof",
    "straight": "straight legs",
    "climbs": "climbs, descents",
    "no_bottom_lock": "no bottom lock",
    "near_bottom": "near the bottom",
    JOINT: "all together",
}


def label(name: str) -> str:
    """Name a state, a quantity or a measurement as people know it; other names stand for themselves."""
    known = name in EVIDENCE_QUANTITIES or name in MEASUREMENTS or name in ALL_CREDIBILITY_GROUPS
    return _LABELS.get(name) or (name.replace("_", " ") if known else name)
