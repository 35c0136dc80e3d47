"""Gates on the trajectory: no change, sample by sample, and conditions over time."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.changes.findings import TRAJECTORY, Finding, UnexpectedFilter
from insdvl_replay.changes.gate_file import ANY, TrajectoryGate
from insdvl_replay.core.dive_columns import Floats, find_runs
from insdvl_replay.core.states import ANGLES, COLUMNS, GROUPS
from insdvl_replay.results.trajectory import Trajectory

# Relative difference of samples from rounding of processors, over the largest value of a group.
SAME: Final = 1e-9
_NEAR_S: Final = 1.0  # a sample that is farther from the time of a gate is not at that time


def trajectory_findings(
    gate: TrajectoryGate,
    new: Trajectory | None,  # of the result; None if it has none
    old: Trajectory | None,  # the expected one, for a gate that compares with it
) -> tuple[Finding, ...]:
    """Return a finding for each filter that a gate checks; one failed finding if it checks none."""
    if new is None:
        sentence = "the result has no trajectory: replay the log again"
        return (_finding(gate.filter, gate.row, sentence, passed=False),)
    checked = [name for name in new.names if gate.filter in (ANY, name)]
    if not checked:
        sentence = f"no filter {gate.filter} in the result"
        return (_finding(gate.filter, gate.row, sentence, passed=False),)
    findings = list[Finding]()
    for name in checked:
        if gate.within:
            findings.append(_over_time(gate, new, name, gate.within))
        else:
            findings.append(_against_expected(gate, new, old, name))
    if old is not None:
        for name in old.names:
            if name not in new.names and gate.filter in (ANY, name):
                sentence = f"{name}: is missing, but in the expected trajectory"
                findings.append(_finding(name, gate.row, sentence, passed=False))
    return tuple(findings)


def _finding(name: str, row: str, sentence: str, *, passed: bool) -> Finding:
    return Finding(TRAJECTORY, name, row, "", None, None, sentence, passed)


# --- No change, sample by sample.


def _against_expected(
    gate: TrajectoryGate, new: Trajectory, old: Trajectory | None, name: str
) -> Finding:
    """Compare a filter with the expected trajectory; name the first quantity that differs."""
    samples = len(new.time_s)
    if old is None or name not in old.names:
        sentence = f"{name}: is not in the expected trajectory"
        return UnexpectedFilter(TRAJECTORY, name, gate.row, "", None, None, sentence, passed=False)
    if not np.array_equal(new.time_s, old.time_s):
        sentence = f"{name}: has {samples} samples, expected: {len(old.time_s)} at other times"
        return _finding(name, gate.row, sentence, passed=False)
    before = old.values[old.names.index(name)]
    apart = _distances(before, new.values[new.names.index(name)])
    allowed = _allowed(gate, before)
    differs = apart > allowed
    if not differs.any():
        return _finding(name, gate.row, f"{name}: {samples} samples are unchanged", passed=True)
    first = int(np.argmax(differs.any(axis=1)))
    place = int(np.argmax(differs[first]))
    column = COLUMNS[place]
    others = int(differs.any(axis=0).sum()) - 1
    sentence = (
        f"{name}: {column} first differs at {new.time_s[first]:g} s (by {apart[first, place]:.2g}, "
        f"allowed: {allowed[place]:.2g}), in all at {int(differs[:, place].sum())} of {samples} samples"
    )
    if others:
        sentence += f", and {others} more quantities"
    return _finding(name, column, sentence, passed=False)


def _distances(before: Floats, after: Floats) -> Floats:
    """Return how far apart two trajectories are, sample by sample, (k, columns)."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(np.where(before == after, 0.0, after - before))
    is_angle = np.isin(COLUMNS, list(ANGLES))
    apart = np.where(is_angle, np.minimum(apart, np.abs(360.0 - apart)), apart)
    # Missing on both sides is the same; missing on one side always differs.
    apart = np.nan_to_num(apart, nan=0.0, posinf=np.inf)
    apart[np.isnan(before) != np.isnan(after)] = np.inf
    return apart


def _allowed(gate: TrajectoryGate, before: Floats) -> Floats:
    """Return how far apart samples may be, (columns,); infinite for what the gate does not look at."""
    share = SAME if gate.max_rel is None else gate.max_rel
    allowed = dict.fromkeys(COLUMNS, math.inf)
    for group, columns in GROUPS.items():
        largest = float(np.nanmax(np.abs(before[:, np.isin(COLUMNS, columns)]), initial=0.0))
        for column in columns:
            if gate.row in (ANY, group, column):
                allowed[column] = gate.max_abs.get(column, share * largest)
    return np.array(list(allowed.values()))


# --- Conditions over time.


def _over_time(
    gate: TrajectoryGate, trajectory: Trajectory, name: str, band: tuple[float, float]
) -> Finding:
    """Check a quantity against its band: at one time, or share of the samples and longest time outside."""
    low, high = band
    values = trajectory.of(name, gate.row)
    inside = (values >= low) & (values <= high)  # a missing value is outside
    statement = "it is"
    if gate.at_s is not None:
        complaints = _complaints_at(gate.at_s, trajectory.time_s, values, inside)
    else:
        share_pct = 100.0 * float(inside.mean())
        length_s, begin_s = _longest_outside(trajectory.time_s, inside)
        statement = (
            f"{share_pct:.1f} % of {len(inside)} samples, outside for {length_s:g} s at most"
        )
        complaints = list[str]()
        least_pct = _least_share_pct(gate)
        if share_pct < least_pct:
            complaints.append(
                f"{share_pct:.1f} % of {len(inside)} samples, required: at least {least_pct:g} %"
            )
        allowed_s = gate.longest_outside_s
        if allowed_s is not None and length_s > allowed_s:
            complaints.append(
                f"outside for {length_s:g} s from {begin_s:g} s, allowed: {allowed_s:g} s"
            )
    said = "; ".join(complaints) if complaints else statement
    sentence = f"{name}: {gate.row} within {low:g} to {high:g}: {said}"
    return _finding(name, gate.row, sentence, passed=not complaints)


def _complaints_at(
    at_s: float, time_s: Floats, values: Floats, inside: NDArray[np.bool_]
) -> list[str]:
    """Say what is wrong at one time."""
    sample = int(np.argmin(np.abs(time_s - at_s)))
    if abs(time_s[sample] - at_s) > _NEAR_S:
        return [f"the replay has no sample at {at_s:g} s"]
    if not inside[sample]:
        return [f"it is {values[sample]:.6g} at {time_s[sample]:g} s"]
    return []


def _least_share_pct(gate: TrajectoryGate) -> float:
    """Return the share of samples that must be inside: all, if the gate states nothing else."""
    if gate.share_pct is not None:
        return gate.share_pct
    if gate.longest_outside_s is not None:
        return 0.0
    return 100.0


def _longest_outside(time_s: Floats, inside: NDArray[np.bool_]) -> tuple[float, float]:
    """Return length and start of the longest time outside, the first of several; one sample a second."""
    longest_s = 0.0
    start_s = 0.0
    for begin, end in zip(*find_runs(~inside), strict=True):
        length_s = float(end - begin)
        if length_s > longest_s:
            longest_s = length_s
            start_s = float(time_s[begin])
    return longest_s, start_s
