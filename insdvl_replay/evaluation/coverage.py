"""What part of a replay a reference, or the truth, says anything about: numbers count, not rows.

Nor is compared what a vehicle does between two samples of a reference that is too slow for its turns.
"""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, TruthColumns, nanoseconds, seconds
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity

WELL_COVERED: Final = 0.9
"""Share of a replay that has to be covered before errors are taken for those of the whole."""
USUAL_STEPS: Final = 5.0
"""A step to the next number of up to so many usual ones is no hole."""
SHORT_S: Final = 2.5
"""Nor is a shorter one."""
SMALL_TURN: Final = 10.0 * DEG
"""Through a smaller turn a straight line between two samples misses less than 0.4 % of the speed, 1 - cos(5 deg)."""
LARGE_TURN: Final = 45.0 * DEG
"""Through a larger one it misses more than 7 %, 1 - cos(22.5 deg), and the turn may have come and gone unseen."""

Known = NDArray[np.bool_]


def covered_share(time_ns: TimeNs, known: Known, start_ns: int, end_ns: int) -> float:
    """Return the share of a span, 0 to 1, that lies between numbers that follow each other about as usual."""
    steps_ns = np.diff(_inside(time_ns[known], start_ns, end_ns))
    if not steps_ns.size:
        return 0.0
    longest_ns = max(USUAL_STEPS * float(np.median(steps_ns)), nanoseconds(SHORT_S))
    return float(steps_ns[steps_ns <= longest_ns].sum() / (end_ns - start_ns))


def reference_coverage_notes(reference: ReferenceColumns, start_ns: int, end_ns: int) -> tuple[Note, ...]:
    """State which quantities of a reference cover too little of a replay, of those that it gives at all."""
    known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
    return tuple(_notes("reference", reference.time_ns, known, start_ns, end_ns))


def truth_coverage_notes(truth: TruthColumns, start_ns: int, end_ns: int) -> tuple[Note, ...]:
    """State which true biases cover too little of a replay."""
    biases = {"accelerometer biases": truth.accel_bias_b, "gyro biases": truth.gyro_bias_b}
    known = {quantity: np.asarray(np.isfinite(values).all(axis=1)) for quantity, values in biases.items()}
    return tuple(_notes("truth", truth.time_ns, known, start_ns, end_ns))


def _notes(source: str, time_ns: TimeNs, known: Mapping[str, Known], start_ns: int, end_ns: int) -> Iterator[Note]:
    """Make a note for each percent, of all that cover so much."""
    alike: dict[str, list[str]] = {}
    for quantity, rows in known.items():
        share = covered_share(time_ns, rows, start_ns, end_ns)
        if share < WELL_COVERED:
            alike.setdefault(f"{100.0 * share:.0f}", []).append(quantity)
    for percent, quantities in alike.items():
        text = (
            f"{_joined(quantities)} of the {source} cover {percent} % of the replay; the errors against them are of "
            "that part alone"
        )
        count = min(len(_inside(time_ns[known[quantity]], start_ns, end_ns)) for quantity in quantities)
        yield Note(f"{source}_coverage", text, count, Severity.WARNING, "--start and --end choose that part")


def _inside(time_ns: TimeNs, start_ns: int, end_ns: int) -> TimeNs:
    return time_ns[(time_ns >= start_ns) & (time_ns <= end_ns)]


def _joined(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def reference_rate_notes(history: History, reference_ns: TimeNs) -> tuple[Note, ...]:
    """State that a reference is too slow for the dive's turns, where it is; any filter's history shows the motion.

    The note counts the intervals with more than `SMALL_TURN`, and is a warning above `LARGE_TURN`.
    """
    since, turn, change_mps = _since_last_sample(history, reference_ns)
    turning = turn > SMALL_TURN
    if not turning.any():
        return ()
    worst = int(np.argmax(turn))
    apart_s = float(seconds(reference_ns[np.searchsorted(reference_ns, since[worst], side="right")], since[worst]))
    text = (
        f"between two samples of the reference, {apart_s:.2g} s apart, the vehicle turns by up to "
        f"{turn[worst] / DEG:.0f} deg and changes its velocity by up to {change_mps.max():.2f} m/s; errors in "
        "between are not seen"
    )
    hint = f"a reference at {turn[worst] / SMALL_TURN / apart_s:.2g} Hz would see this turn"
    count = len(np.unique(since[turning]))
    return (Note("reference_slow", text, count, Severity.WARNING if turn[worst] > LARGE_TURN else Severity.INFO, hint),)


def _since_last_sample(history: History, reference_ns: TimeNs) -> tuple[TimeNs, Floats, Floats]:
    """Return the time of the last sample before each recorded time, and turn and change of velocity since then."""
    sampled = np.flatnonzero(np.isin(history.time_ns, reference_ns))
    if len(sampled) < 2:
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    rows = np.arange(sampled[0] + 1, sampled[-1] + 1)
    last = sampled[np.searchsorted(sampled, rows, side="left") - 1]
    # The trace of a rotation is 1 + 2 cos(angle).
    trace = np.einsum("kij,kij->k", history.mat_nb[rows], history.mat_nb[last])
    turn = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    change_mps = np.linalg.norm(history.velocity_n[rows] - history.velocity_n[last], axis=1)
    return history.time_ns[last], turn, change_mps
