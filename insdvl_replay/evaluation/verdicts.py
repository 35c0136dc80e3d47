"""Verdicts in words: whether a filter is as good as it says, and whether a believed improvement is one.

An improvement is borne out when the error against the reference falls by at least half of what the filter believes. A
filter is called over-confident or over-cautious when its innovations, or its errors against the reference, say so with
significance and by a size that matters, as `chi_square.verdict` decides. Where the two disagree, the sentence names
both. Of a filter that is dead, or is held against one that is, nothing is said of gain or loss.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from scipy.special import chdtrc

from insdvl_replay.core.columns import NS_PER_S
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.tables import (
    JOINT,
    VERDICTS_BEST_FIRST,
    Candidate,
    ConsistencyRow,
    CredibilityRow,
    ReferenceErrorRow,
    Tables,
    finite,
    is_whole,
)
from insdvl_replay.core.words import Consistency, Gain, ReferenceStatus
from insdvl_replay.evaluation.believed import mean_over_nine
from insdvl_replay.evaluation.consistency import MANY_REJECTED, rejections

NOTABLE_PCT: Final = 5.0
"""A smaller change, believed or real, is not spoken of as an improvement."""
BORNE_OUT: Final = 0.5
"""Share of the believed improvement that the reference has to confirm."""
COMPARED: Final = ("velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "heading", "position_h")
"""Quantities whose median change stands for the error against the reference."""
GRAVEST_FIRST: Final = (*reversed(VERDICTS_BEST_FIRST), Consistency.TOO_FEW)
MANY_REOPENED: Final = 0.01
"""Share of the pings; each comes after several that were rejected."""
FEW: Final = 2
"""So many rejections prove nothing, in however short a dive."""


def verdicts(tables: Tables, baseline: str, candidates: Sequence[str], dead: Mapping[str, str]) -> dict[str, Candidate]:
    """Judge each candidate.

    Parameters
    ----------
    baseline : str
        Name of the first filter.
    candidates : sequence of str
        Names of the others.
    dead : mapping of str to str
        What is wrong with filters that cannot be judged, from `dead_filters`.
    """
    return {candidate: _verdict(tables, baseline, candidate, dead) for candidate in candidates}


def consistency_of(table: Sequence[ConsistencyRow], filter_name: str) -> str:
    """Return the gravest verdict among a filter's measurements.

    Their axes say where and do not count: of eight tests one fails by chance in every third honest filter.
    """
    found = {row.verdict for row in table if row.filter == filter_name and is_whole(row.measurement)}
    return next((word for word in GRAVEST_FIRST if word in found), Consistency.TOO_FEW)


def credibility_of(table: Sequence[CredibilityRow], filter_name: str) -> str:
    """Return the verdict of a filter's errors against the reference, of all states together."""
    return next(row.verdict for row in table if (row.filter, row.quantity) == (filter_name, JOINT))


def _verdict(tables: Tables, baseline: str, candidate: str, dead: Mapping[str, str]) -> Candidate:
    believed_pct = mean_over_nine(tables.improvement, candidate)
    rows = [row for row in tables.reference_error if row.filter == candidate]
    compared = {row.quantity: row for row in rows if row.status == ReferenceStatus.COMPARED}
    actual_pct = _median_pct(compared)
    wrong = list(dict.fromkeys(dead[name] for name in (baseline, candidate) if name in dead))
    improvement = Gain.NOT_JUDGED if wrong else _borne_out(believed_pct, actual_pct)
    (consistency, credibility), of_baseline = (
        (consistency_of(tables.consistency, name), credibility_of(tables.credibility, name))
        for name in (candidate, baseline)
    )
    partly = any(row.status == ReferenceStatus.PARTLY_COVERED for row in rows)
    gain = (
        f"{candidate} is NOT JUDGED against {baseline}: {' and '.join(wrong)}; settle that first"
        if wrong
        else f"{candidate} {_believes(believed_pct, baseline)}; "
        f"{_against_reference(compared.get('position_h'), actual_pct, partly=partly)}: {_CONCLUSION[improvement]}"
    )
    trust = _on_trust(_trust(consistency, credibility), _trust(*of_baseline), candidate, baseline)
    return Candidate(
        verdict=f"{gain}. {trust}",
        improvement=improvement,
        consistency=consistency,
        mean_improvement_pct=believed_pct,
        mean_convergence_improvement_pct=mean_over_nine(tables.convergence, candidate),
        reference_improvement_pct=actual_pct,
        credibility=credibility,
    )


def _median_pct(compared: Mapping[str, ReferenceErrorRow]) -> float:
    """Return the median improvement of the compared quantities that have one, NaN without any."""
    changes = [finite(row.improvement_pct) for quantity, row in compared.items() if quantity in COMPARED]
    known = [change for change in changes if np.isfinite(change)]
    return float(np.median(known)) if known else float("nan")


def _borne_out(believed_pct: float, actual_pct: float) -> Gain:
    if not np.isfinite(actual_pct):
        return Gain.NO_REFERENCE
    if actual_pct < -NOTABLE_PCT:
        return Gain.WORSE
    if not believed_pct >= NOTABLE_PCT:
        return Gain.NONE_BELIEVED
    return Gain.BORNE_OUT if actual_pct >= BORNE_OUT * believed_pct else Gain.NOT_BORNE_OUT


_CONCLUSION: Final = {
    Gain.BORNE_OUT: "the improvement is borne out",
    Gain.NOT_BORNE_OUT: "the improvement is NOT borne out",
    Gain.WORSE: "it is WORSE",
    Gain.NONE_BELIEVED: "no improvement",
    Gain.NO_REFERENCE: "nothing tells whether that is so",
}


def _believes(believed_pct: float, baseline: str) -> str:
    if not np.isfinite(believed_pct):
        return "believes in nothing finite"
    if abs(believed_pct) < NOTABLE_PCT:
        return f"believes in errors as large as those of {baseline} ({believed_pct:+.1f} %)"
    return f"believes in {abs(believed_pct):.1f} % {'smaller' if believed_pct > 0 else 'larger'} errors than {baseline}"


def _against_reference(position: ReferenceErrorRow | None, actual_pct: float, *, partly: bool) -> str:
    if not np.isfinite(actual_pct):
        missing = "the reference covers too little of the replay" if partly else "there is no reference"
        return f"{missing} to compare with"
    size = "smaller" if actual_pct >= 0 else "larger"
    change = f"the errors against the reference are {abs(actual_pct):.1f} % {size} in the median"
    if position is None:
        return change
    return f"{change} (position {finite(position.baseline_rmse):.2f} m, now {finite(position.rmse):.2f} m)"


def _trust(consistency: str, credibility: str) -> str:
    """Join what innovations and errors say; the one word where they agree or only one of them speaks."""
    if credibility in (consistency, Consistency.TOO_FEW) or credibility not in GRAVEST_FIRST:
        return consistency
    if consistency == Consistency.TOO_FEW:
        return f"{credibility} against the reference"
    return f"{consistency} by the innovations and {credibility} against the reference"


def _on_trust(trust: str, of_baseline: str, candidate: str, baseline: str) -> str:
    if trust != of_baseline:
        return f"{candidate} is {trust}, {baseline} {of_baseline}."
    return "Too few updates to judge either." if trust == Consistency.TOO_FEW else f"Both filters are {trust}."


def dead_filters(histories: tuple[History, ...]) -> dict[str, str]:
    """Find the filters that are not to be judged.

    Returns
    -------
    dict of str to str
        By name of the filter what is wrong with it; those that are sound are left out. A filter is dead where its state
        is not finite, where its gate rejected more than `MANY_REJECTED` of what locks it out (the velocities, or the
        accelerations of a filter that has no others), or where it was set to the DVL again more than once and at more
        than `MANY_REOPENED` of its pings. What a gate rejects of a sound filter by chance is allowed for.
    """
    found = {
        history.filter: _not_finite(history) or _locked_out(history) or _set_again(history) for history in histories
    }
    return {name: wrong for name, wrong in found.items() if wrong}


def _not_finite(history: History) -> str:
    columns = (history.position, history.velocity_n, history.mat_nb, history.accel_bias_b, history.gyro_bias_b)
    finite = np.isfinite(history.sd).all(axis=1)
    for column in columns:
        finite &= np.isfinite(column.reshape(len(column), -1)).all(axis=1)
    if finite.all():
        return ""
    first_s = (history.time_ns[np.argmin(finite)] - history.time_ns[0]) / NS_PER_S
    return f"the state of {history.filter} is not finite from {first_s:.1f} s on"


def _locked_out(history: History) -> str:
    innovations = _leading(history)
    if innovations is None:
        return ""
    rejected, total = rejections(innovations), len(innovations.used)
    if rejected <= max(FEW, (MANY_REJECTED + _by_chance(innovations)) * total):
        return ""
    return f"{history.filter} rejected {rejected} of {total} {innovations.measurement} innovations"


def _set_again(history: History) -> str:
    """Find a filter that is not thrown off once, but errs all the time, and is saved from itself every so often."""
    innovations = _leading(history)
    if innovations is None:
        return ""
    reopened, total = int(innovations.reopened.sum()), len(innovations.used)
    if reopened <= max(1.0, (MANY_REOPENED + _by_chance(innovations) ** innovations.reopen_after) * total):
        return ""
    return f"{history.filter} lost its way {reopened} times in {total} velocity innovations"


def _by_chance(innovations: Innovations) -> float:
    """Return the share of the innovations that the gate of a sound filter rejects."""
    return float(chdtrc(innovations.dof, innovations.gate))


def _leading(history: History) -> Innovations | None:
    velocities = [innovations for innovations in history.innovations if innovations.measurement == "velocity"]
    return next(iter((*velocities, *history.innovations)), None)
