"""Two filters on one dive: their errors against the reference in the same quantities at the same times."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.quantities import TRACK_STRETCHES
from insdvl_replay.core.states import DEG, POSITION
from insdvl_replay.core.tables import CredibilityRow, EvidenceRow, ReferenceErrorRow
from insdvl_replay.evaluation.credibility import credibility_table, state_errors
from insdvl_replay.evaluation.evaluate import (
    accuracy_series,
    ends_of,
    position_crps,
    track_series,
)
from insdvl_replay.evaluation.evidence import (
    ErrorSeries,
    Measured,
    ReferenceNoise,
    Series,
    evidence_table,
    settling_times,
)
from insdvl_replay.evaluation.reference_errors import (
    ReferenceErrors,
    covered_share,
    reference_error_table,
    reference_errors,
)
from insdvl_replay.evaluation.series import common_noise
from insdvl_replay.evaluation.verdicts import far_off
from insdvl_replay.trajectories.tracks import (
    Placed,
    Track,
    history_of,
    reference_of,
)

NO_NOISE: Final = ReferenceNoise(0.0, 0.0, 0.0)
LEAST_COVERED: Final = 0.5  # share of a dive that both filters must cover


@dataclass(frozen=True)
class Pairing:
    """The runs of two filters on one dive, at the same times."""

    log: str  # the dive
    names: tuple[str, str]  # of OLD and of NEW
    time_ns: TimeNs
    truth: Placed
    old: Sequence[Placed]  # repeated runs
    new: Sequence[Placed]


@dataclass(frozen=True)
class DiveEvidence:
    """What one dive says of a filter against another."""

    rows: Sequence[EvidenceRow]
    credibility: Sequence[CredibilityRow]
    reason: str = ""  # why the dive says nothing
    noise: ReferenceNoise = NO_NOISE
    # logarithms of the errors of each run, by quantity
    old_logs: Mapping[str, Sequence[float]] = field(default_factory=dict)
    new_logs: Mapping[str, Sequence[float]] = field(default_factory=dict)


class _Pair:
    """A run of OLD and a run of NEW, and their errors."""

    def __init__(self, pairing: Pairing, old: Placed, new: Placed) -> None:
        time_ns = pairing.time_ns
        self.reference = reference_of(pairing.truth, time_ns)
        before, after = pairing.names
        self.histories = (history_of(before, old, time_ns), history_of(after, new, time_ns))
        self.errors: dict[str, ReferenceErrors] = {}
        for history in self.histories:
            self.errors[history.filter] = reference_errors(
                history, self.reference, self.histories[0]
            )

    def noise(self, truth: Track) -> ReferenceNoise:
        """Return the noise of the reference: as it states it, or as both errors show it, if that is more."""
        stated = _stated_noise(truth)
        before, after = (self.errors[history.filter] for history in self.histories)
        position_m = common_noise(
            before.position_error_ned_m[:, :2], after.position_error_ned_m[:, :2]
        )
        velocity_mps = common_noise(before.velocity_error_n, after.velocity_error_n)
        attitude = common_noise(before.attitude_error_rad, after.attitude_error_rad)
        return ReferenceNoise(
            max(stated.position_m, position_m),
            max(stated.velocity_mps, velocity_mps),
            max(stated.attitude_deg, attitude / DEG),
        )

    def accuracy(self, noise: ReferenceNoise) -> tuple[Series, Series]:
        """Return the errors of both in velocity, attitude and drift."""
        settled_s = settling_times(self.histories[0], self.histories[0].time_ns[1:])
        found = accuracy_series(
            self.histories,
            self.errors,
            self.reference,
            noise,
            settled_s,
            bridged_gaps=False,
            stretches=TRACK_STRETCHES,
        )
        return self._of_both(found)

    def track(self, noise: ReferenceNoise) -> tuple[Series, Series]:
        """Return the errors of both in position and depth."""
        found = track_series(self.histories, self.errors, noise, bridged_gaps=False)
        return self._of_both(found)

    def _of_both(self, found: Mapping[str, Series]) -> tuple[Series, Series]:
        before, after = self.histories
        return found[before.filter], found[after.filter]

    def reference_error(self, log: str) -> list[ReferenceErrorRow]:
        """Return the errors of both in numbers."""
        return reference_error_table(log, self.histories, self.errors)

    def crps(self) -> tuple[float, float] | None:
        """Return the CRPS of the position of both; None if one of them has no covariance."""
        if not all(history.predicted[POSITION].all() for history in self.histories):
            return None
        before, after = self.histories
        return position_crps(before, self.errors), position_crps(after, self.errors)


def dive_evidence(pairing: Pairing) -> DiveEvidence:
    """Compare the runs of two filters; several runs of one filter stand together for it."""
    reason = _lacks_positions(pairing) or _covers_little(pairing)
    if reason:
        return DiveEvidence([], [], reason)
    before, after = pairing.names
    pairs = [_Pair(pairing, old, new) for old, new in _in_pairs(pairing.old, pairing.new)]
    first = pairs[0]
    sizes = first.reference_error(pairing.log)
    baseline, _ = first.histories
    far = [far_off(history, baseline, first.errors, sizes) for history in first.histories]
    if all(far):
        return DiveEvidence([], [], f"{' and '.join(far)}; other frames? --align yaw")
    credibility = _credibility(pairing.log, first)
    noise = first.noise(pairing.truth.track)
    accuracies = [pair.accuracy(noise) for pair in pairs]
    tracks = [pair.track(noise) for pair in pairs]
    measured = Measured(
        accuracy={after: _together(accuracies)},
        track={after: _together(tracks)},
        ends={after: _ends(pairing.log, pairs, after)},
        crps=_crps(pairs, after),
        partial=[after],
        late_mps=None,
    )
    rows = evidence_table(pairing.log, before, [after], measured, [], credibility)
    return DiveEvidence(
        rows,
        credibility,
        noise=noise,
        old_logs=_logs_of_runs([tracks, accuracies], len(pairing.old), 0, len(pairing.new)),
        new_logs=_logs_of_runs([tracks, accuracies], len(pairing.new), 1, len(pairing.old)),
    )


def _stated_noise(truth: Track) -> ReferenceNoise:
    """Return the noise that the reference states, root mean square over time and axes; 0 where it states none."""
    variance = np.diagonal(truth.columns.cov, axis1=1, axis2=2)
    blocks = (
        slice(6, 8),
        slice(0, 3),
        slice(3, 6),
    )  # of position, horizontally, velocity, attitude
    sizes = list[float]()
    for block in blocks:
        known = variance[:, block]
        known = known[np.isfinite(known)]
        sizes.append(math.sqrt(float(np.mean(known))) if len(known) else 0.0)
    position_m, velocity_mps, attitude = sizes
    return ReferenceNoise(position_m, velocity_mps, attitude / DEG)


def _in_pairs(old: Sequence[Placed], new: Sequence[Placed]) -> list[tuple[Placed, Placed]]:
    """Pair the runs: in their order, or each with each where one side has more."""
    if len(old) == len(new):
        return list(zip(old, new, strict=True))
    return list(product(old, new))


def _lacks_positions(pairing: Pairing) -> str:
    """Say which filter has no positions where the other one has; empty if none lacks them."""
    if not pairing.truth.track.has_position:
        return ""
    before = all(run.track.has_position for run in pairing.old)
    after = all(run.track.has_position for run in pairing.new)
    if before == after:
        return ""
    name = pairing.names[1] if before else pairing.names[0]
    return f"{name} has no positions"


def _covers_little(pairing: Pairing) -> str:
    """Say which filter covers too little of the dive; empty if none does."""
    reasons = list[str]()
    tracks = [pairing.truth.track, *(run.track for run in (*pairing.old, *pairing.new))]
    truth, *runs = tracks
    start_ns = max(int(truth.known_ns[0]), min(int(run.known_ns[0]) for run in runs))
    end_ns = min(int(truth.known_ns[-1]), max(int(run.known_ns[-1]) for run in runs))
    for name, placed in zip(pairing.names, (pairing.old, pairing.new), strict=True):
        share = min(share_covered(run.track, start_ns, end_ns) for run in placed)
        if share < LEAST_COVERED:
            reasons.append(f"{name} covers {100.0 * share:.0f} % of the dive")
    return " and ".join(reasons)


def share_covered(track: Track, start_ns: int, end_ns: int) -> float:
    """Return the share of a span, 0 to 1, that a trajectory covers."""
    if end_ns <= start_ns:
        return 0.0
    return covered_share(track.time_ns, track.known, start_ns, end_ns)


def _together(pairs: Sequence[tuple[Series, Series]]) -> tuple[Series, Series]:
    """Return the errors of all pairs of runs one behind the other, in the quantities that all have."""
    before: dict[str, ErrorSeries] = {}
    after: dict[str, ErrorSeries] = {}
    for quantity in pairs[0][0]:
        if all(quantity in old and quantity in new for old, new in pairs):
            before[quantity] = _joined([old[quantity] for old, _ in pairs])
            after[quantity] = _joined([new[quantity] for _, new in pairs])
    return before, after


def _joined(series: Sequence[ErrorSeries]) -> ErrorSeries:
    first = series[0]
    if len(series) == 1:
        return first
    return first._replace(errors=np.concatenate([each.errors for each in series]))


def _ends(log: str, pairs: Sequence[_Pair], name: str) -> dict[str, tuple[float, float]]:
    """Return the root mean square over the runs of the errors of both filters at the end."""
    squares: dict[str, list[tuple[float, float]]] = {}
    for pair in pairs:
        found = ends_of(pair.histories[1:], pair.reference_error(log))
        for quantity, (before, after) in found.get(name, {}).items():
            squares.setdefault(quantity, []).append((before**2, after**2))
    ends: dict[str, tuple[float, float]] = {}
    for quantity, values in squares.items():
        before, after = np.sqrt(np.mean(values, axis=0)).tolist()
        ends[quantity] = (before, after)
    return ends


def _crps(pairs: Sequence[_Pair], name: str) -> dict[str, tuple[float, float]]:
    """Return the mean CRPS of the position of both filters; nothing without covariances."""
    found = [pair.crps() for pair in pairs]
    known = [values for values in found if values is not None]
    if not known or len(known) < len(found):
        return {}
    before, after = np.mean(known, axis=0).tolist()
    return {name: (before, after)}


def _credibility(log: str, pair: _Pair) -> list[CredibilityRow]:
    """Return whether the errors of both are as large as they say; no rows of one that says nothing."""
    rows = list[CredibilityRow]()
    for history in pair.histories:
        if len(history.cov_ns):
            errors = state_errors(history, pair.reference, None)
            rows += credibility_table(log, [history.filter], {history.filter: errors})
    return rows


def _logs_of_runs(
    kinds: Sequence[Sequence[tuple[Series, Series]]],  # of each pair of runs
    count: int,  # of the runs of this side
    side: int,
    others: int,  # runs of the other side
) -> dict[str, list[float]]:
    """Return the logarithm of the error of each run of one side, by quantity; nothing of a single run."""
    logs: dict[str, list[float]] = {}
    if count < 2:
        return logs
    for pairs in kinds:
        chosen = pairs[:count]
        if side == 0 and len(pairs) > count:
            chosen = pairs[::others]
        for pair in chosen:
            for quantity, found in pair[side].items():
                logs.setdefault(quantity, []).append(_log_rms(found.errors))
    return logs


def _log_rms(errors: Floats) -> float:
    known = errors[np.isfinite(errors).all(axis=1)]
    if not len(known):
        return math.nan
    square = float(np.mean(np.sum(known**2, axis=1)))
    return 0.5 * math.log(square) if square > 0.0 else math.nan
