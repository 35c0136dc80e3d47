"""What part of a replay a reference, or the truth, says anything about: numbers count, not rows."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import ReferenceColumns, TimeNs, TruthColumns, nanoseconds
from insdvl_replay.core.errors import Note

WELL_COVERED: Final = 0.9
"""Share of a replay that has to be covered before errors are taken for those of the whole."""
USUAL_STEPS: Final = 5.0
"""A step to the next number of up to so many usual ones is no hole."""
SHORT_S: Final = 2.5
"""Nor is a shorter one."""

Known = NDArray[np.bool_]


def covered_share(time_ns: TimeNs, known: Known, start_ns: int, end_ns: int) -> float:
    """Give the share of a span that lies between numbers that follow each other about as usual.

    Parameters
    ----------
    time_ns : ndarray, shape (r,)
        In order.
    known : ndarray of bool, shape (r,)
        Which rows hold numbers.
    start_ns, end_ns : int

    Returns
    -------
    float
        From 0 to 1.
    """
    steps_ns = np.diff(_inside(time_ns[known], start_ns, end_ns))
    if not steps_ns.size:
        return 0.0
    longest_ns = max(USUAL_STEPS * float(np.median(steps_ns)), nanoseconds(SHORT_S))
    return float(steps_ns[steps_ns <= longest_ns].sum() / (end_ns - start_ns))


def reference_coverage_notes(reference: ReferenceColumns, start_ns: int, end_ns: int) -> tuple[Note, ...]:
    """Say which quantities of a reference cover too little of a replay.

    Parameters
    ----------
    reference : ReferenceColumns
    start_ns, end_ns : int
        Of the replay.

    Returns
    -------
    tuple of Note
        One for all quantities that cover the same. What the reference never gives is not among them.
    """
    known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
    return tuple(_notes("reference", reference.time_ns, known, start_ns, end_ns))


def truth_coverage_notes(truth: TruthColumns, start_ns: int, end_ns: int) -> tuple[Note, ...]:
    """Say which true biases cover too little of a replay.

    Parameters
    ----------
    truth : TruthColumns
    start_ns, end_ns : int
        Of the replay.

    Returns
    -------
    tuple of Note
    """
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
        yield Note(f"{source}_coverage", text, count, "warning", "--start and --end choose that part")


def _inside(time_ns: TimeNs, start_ns: int, end_ns: int) -> TimeNs:
    return time_ns[(time_ns >= start_ns) & (time_ns <= end_ns)]


def _joined(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
