"""Gates on the trajectory: that nothing changed, sample by sample, and conditions over time."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import ANGLES, GROUPS
from insdvl_replay.gates.model import ANY, Finding, Gate
from insdvl_replay.gates.trajectory_keys import is_over_time
from insdvl_replay.results.trajectory import Trajectory

SAME: Final = 1e-9
"""Share of the largest value of a group in which samples may differ: processors round differently."""


def trajectory_findings(gate: Gate, new: Trajectory | None, old: Trajectory | None) -> tuple[Finding, ...]:
    """Return a finding for each filter that a gate means; one not passed if it means none.

    Parameters
    ----------
    new : Trajectory or None
        Of the result; None if it has none.
    old : Trajectory or None
        The baseline's, for a gate that holds against it.
    """
    if new is None:
        return (_finding(gate, gate.filter, "", "the result has no trajectory: replay the log again", passed=False),)
    names = [name for name in new.names if gate.filter in (ANY, name)]
    if not names:
        return (_finding(gate, gate.filter, "", f"no filter {gate.filter} in the result", passed=False),)
    if is_over_time(gate):
        return tuple(_over_time(gate, new, name) for name in names)
    assert old is not None
    gone = [name for name in old.names if name not in new.names and gate.filter in (ANY, name)]
    return (
        *(_against(gate, new, old, name) for name in names),
        *(_finding(gate, name, "", f"{name}: is gone, the baseline has it", passed=False) for name in gone),
    )


def _finding(gate: Gate, name: str, row: str, sentence: str, *, passed: bool) -> Finding:
    return Finding("trajectory", name, row or gate.row, "", None, None, sentence, passed)


def _against(gate: Gate, new: Trajectory, old: Trajectory, name: str) -> Finding:
    """Find the first sample and quantity in which a filter differs from the baseline."""
    if name not in old.names:
        return _finding(gate, name, "", f"{name}: is not in the baseline", passed=False)
    if not np.array_equal(new.time_s, old.time_s):
        sentence = f"{name}: {len(new.time_s)} samples, the baseline has {len(old.time_s)} at other times"
        return _finding(gate, name, "", sentence, passed=False)
    found = [differs for differs in _differences(gate, new, old, name) if differs[1].any()]
    if not found:
        return _finding(gate, name, "", f"{name}: {len(new.time_s)} samples are as before", passed=True)
    # The first in time; of those at one time the first in the order of the columns.
    column, where, amount, allowed = min(found, key=lambda differs: int(np.argmax(differs[1])))
    first = int(np.argmax(where))
    others = f", and {len(found) - 1} more quantities" if len(found) > 1 else ""
    sentence = (
        f"{name}: {column} first differs at {new.time_s[first]:g} s ({amount[first]:.2g}, {allowed:.2g} allowed), "
        f"{int(where.sum())} of {len(where)} samples{others}"
    )
    return _finding(gate, name, column, sentence, passed=False)


def _differences(
    gate: Gate, new: Trajectory, old: Trajectory, name: str
) -> Iterator[tuple[str, NDArray[np.bool_], Floats, float]]:
    """Yield each column with where it differs by more than is allowed, by how much, and what is allowed."""
    for group, columns in GROUPS.items():
        meant = [column for column in columns if gate.row in (ANY, group, column)]
        if not meant:
            continue
        with np.errstate(invalid="ignore"):
            largest = max(float(np.nanmax(np.abs(old.of(name, column)), initial=0.0)) for column in columns)
        for column in meant:
            allowed = gate.max_abs.get(column, (SAME if gate.max_rel is None else gate.max_rel) * largest)
            before, after = old.of(name, column), new.of(name, column)
            amount = _apart(before, after, column)
            # What is missing on both sides is the same; on one side it differs by any measure.
            lost = np.isnan(before) != np.isnan(after)
            amount = np.where(lost, np.inf, np.nan_to_num(amount, nan=0.0, posinf=np.inf))
            yield column, np.asarray(amount > allowed), amount, allowed


def _apart(before: Floats, after: Floats, column: str) -> Floats:
    with np.errstate(invalid="ignore"):
        apart: Floats = np.abs(np.where(before == after, 0.0, after - before))
        return np.minimum(apart, np.abs(360.0 - apart)) if column in ANGLES else apart


def _over_time(gate: Gate, trajectory: Trajectory, name: str) -> Finding:
    """Hold a quantity in its band: for a share of the samples, never outside for long, or at one time."""
    assert gate.within is not None
    low, high = gate.within
    values = trajectory.of(name, gate.row)
    inside = (values >= low) & (values <= high)  # what is missing is outside
    complaints: list[str] = []
    told = "it is"
    if gate.at_s is not None:
        complaints += _at(gate, trajectory.time_s, values, inside)
    else:
        share_pct = 100.0 * float(inside.mean())
        wanted_pct = 100.0 if gate.share_pct is None and gate.longest_outside_s is None else gate.share_pct or 0.0
        if share_pct < wanted_pct:
            complaints.append(f"{share_pct:.1f} % of {len(inside)} samples are, at least {wanted_pct:g} % are wanted")
        length_s, begin_s = _longest_outside(inside, trajectory.time_s)
        if gate.longest_outside_s is not None and length_s > gate.longest_outside_s:
            complaints.append(
                f"outside for {length_s:g} s from {begin_s:g} s, {gate.longest_outside_s:g} s are allowed"
            )
        told = f"{share_pct:.1f} % of {len(inside)} samples are, outside for {length_s:g} s at most"
    sentence = f"{name}: {gate.row} within {low:g} to {high:g}: {'; '.join(complaints) or told}"
    return _finding(gate, name, gate.row, sentence, passed=not complaints)


def _at(gate: Gate, time_s: Floats, values: Floats, inside: NDArray[np.bool_]) -> Iterator[str]:
    assert gate.at_s is not None
    sample = int(np.argmin(np.abs(time_s - gate.at_s)))
    if abs(time_s[sample] - gate.at_s) > 1.0:
        yield f"the replay has no sample at {gate.at_s:g} s"
    elif not inside[sample]:
        yield f"it is {values[sample]:.6g} at {time_s[sample]:g} s"


def _longest_outside(inside: NDArray[np.bool_], time_s: Floats) -> tuple[float, float]:
    """Return how long the longest stay outside lasts, a sample a second, and when it begins."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], inside, [True]]).astype(np.int8)))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return 0.0, 0.0
    longest = int(np.argmax(runs[:, 1] - runs[:, 0]))
    begin, end = runs[longest].tolist()
    return float(end - begin), float(time_s[begin])
