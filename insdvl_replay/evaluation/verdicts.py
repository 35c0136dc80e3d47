"""The verdict on the candidates of one dive: what keeps them from being evaluated, and how consistent they are.

Filters that diverged or are misconfigured are not evaluated. No candidate of such a baseline is evaluated either. A
filter of the user's whose answers differ from run to run is not repeatable.
"""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from msgspec.structs import replace
from scipy.special import chdtrc

from insdvl_replay.core.dive_columns import NS_PER_S, Mask, TimeNs, in_pauses
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.notes import note
from insdvl_replay.core.of_reference import OfReference
from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    SETTLED,
    SETTLED_PREFIX,
    VERDICTS_BEST_FIRST,
    WITHOUT_VERDICT,
    is_beam,
    is_used,
)
from insdvl_replay.core.states import DVL_AIDING
from insdvl_replay.core.tables import (
    CandidateVerdict,
    ConsistencyRow,
    CredibilityRow,
    ReferenceErrorRow,
    Tables,
    finite,
)
from insdvl_replay.core.words import Consistency, ReferenceStatus, Role
from insdvl_replay.evaluation.answers import median_of, pooled_candidate, primary_of
from insdvl_replay.evaluation.consistency import (
    LARGEST_PER_DOF,
    MANY_REJECTED,
    SMALLEST_PER_DOF,
    rejected,
)
from insdvl_replay.evaluation.convergence import (
    mean_over_nine,
    nearest_over_nine,
    unchanged_over_nine,
)
from insdvl_replay.evaluation.outage_test import OUTAGE, outage_alarm
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.evaluation.sentences import paragraph

# Quantities whose median change summarises the error against the reference.
COMPARED: Final = (
    "velocity_n",
    "velocity_e",
    "velocity_d",
    "roll",
    "pitch",
    "heading",
    "position_h",
)
WORST_FIRST: Final = (*reversed(VERDICTS_BEST_FIRST), Consistency.INSUFFICIENT)
MANY_REOPENED: Final = 0.01  # Share of the pings; each comes after several that were rejected.
FEW: Final = 2  # Up to this number of rejections prove nothing, even in a short dive.
# Percent of the distance, with the DVL available. Dead reckoning by a DVL without an INS drifts less.
FARTHEST_PCT: Final = 20.0
# Notes on columns of a dive that contradict each other.
CONTRADICTIONS: Final = (
    "dvl_beam_contradiction",
    "dvl_contradiction",
    "dvl_direction",
    "imu_gyro_contradiction",
    "imu_gyro_sign",
    "imu_upside_down",
    "reference_contradiction",
    "reference_other_clock",
    "start_heading_contradiction",
    "track_contradiction",
)
SHARED: Final = "The reference shares sensors with the filters, so errors that they have in common are not visible."


# --- Verdicts over several rows.


def consistency_of(table: Sequence[ConsistencyRow], filter_name: str) -> str:
    """Return the worst verdict among a filter's measurements.

    Axes do not count: with eight tests, every third consistent filter fails one by chance.
    """
    words = {
        row.verdict for row in table if row.filter == filter_name and is_used(row.measurement)
    }
    if not words:
        return Consistency.NOT_AVAILABLE
    return _worst_of(words, Consistency.INSUFFICIENT)


def _worst_of(words: Collection[str], otherwise: str) -> str:
    """Return the worst verdict of some words, another word where none of them is a verdict."""
    for word in WORST_FIRST:
        if word in words:
            return word
    return otherwise


def credibility_of(table: Sequence[CredibilityRow], filter_name: str) -> str:
    """Return the worst verdict among the groups of states, for errors against the reference.

    All states together may be consistent although roll and pitch are far off, if the velocity errors are small. If no
    group could be compared, the reason of the first is returned.
    """
    own = [row for row in table if row.filter == filter_name]
    words = [row.verdict for row in own if row.quantity in ALL_CREDIBILITY_GROUPS]
    if words:
        return _worst_of(words, words[0])
    if own or not table:
        return Consistency.NO_REFERENCE
    return Consistency.NOT_AVAILABLE


# --- Filters that are not evaluated.


def not_evaluated(
    histories: tuple[History, ...],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter; empty without a reference
    tables: Tables,
    notes: Sequence[Note],  # of the dive
) -> dict[str, str]:
    """Return, by candidate, why it is not evaluated; candidates without a problem are left out.

    Where columns of the dive contradict each other, as a note then says, no filter is evaluated.
    If only one of the two filters is far off, the evidence shows it. A baseline whose noise is far from what its
    innovations or errors show is none to judge by (`misfit`), nor is a candidate that misreads a sensor of its own
    (`misread`).
    """
    invalid = _invalid_filters(histories, notes) | diverged_filters(histories)
    suspect = _suspect_filters(histories, errors, tables)
    baseline, *candidates = (history.filter for history in histories)
    unusable = _contradictions(notes) or misfit(baseline, tables)
    unsound = {}
    for candidate in candidates:
        wrong = [invalid[name] for name in (baseline, candidate) if name in invalid]
        if baseline in suspect and candidate in suspect:
            wrong += [suspect[baseline], suspect[candidate]]
        reason = " and ".join(wrong) or unusable or misread(candidate, tables.consistency)
        if reason:
            unsound[candidate] = reason
    return unsound


def _invalid_filters(histories: Sequence[History], notes: Sequence[Note]) -> dict[str, str]:
    """Return, by filter, why it failed, or why its errors against the reference mean nothing.

    They mean nothing for filters that are aided by the reference's own readings. Depth is an exception: it neither
    decides nor warns, and the rest of the reference is still valid.
    """
    of_reference = OfReference.noted(notes)
    invalid = {}
    for history in histories:
        name = history.filter
        if history.failure:
            invalid[name] = history.failure
        if name in of_reference.solutions:
            invalid[name] = f"{name} is the reference, or may have used it"
        for met in history.innovations:
            sensor = met.measurement
            if sensor in of_reference.sensors and sensor != "depth":
                invalid[name] = f"{name} is aided by the {sensor} of the reference"
    return invalid


def _suspect_filters(
    histories: Sequence[History], errors: Mapping[str, ReferenceErrors], tables: Tables
) -> dict[str, str]:
    """Return, by filter, why it is far off."""
    suspect = {}
    for history in histories:
        found = surprised(history.filter, tables.consistency)
        found = found or far_off(history, histories[0], errors, tables.reference_error)
        if found:
            suspect[history.filter] = found
    return suspect


def _contradictions(notes: Sequence[Note]) -> str:
    """Return in what columns of the dive contradict each other; empty if they do not."""
    texts = [
        note.text for note in notes if note.code in CONTRADICTIONS and note.severity == "warning"
    ]
    return "; ".join(texts)


def diverged_filters(histories: tuple[History, ...]) -> dict[str, str]:
    """Return, by filter, why it diverged; filters that did not are left out.

    A filter diverged if its state is not finite, if its gate rejected more than `MANY_REJECTED` of its main aiding, or
    if it was set to the DVL again more than once and at more than `MANY_REOPENED` of its pings. Chance is allowed for.
    Partial solutions are not checked.
    """
    found = {}
    for history in histories:
        if history.is_partial:
            continue
        reason = _not_finite(history) or _gated_out(history)
        if reason:
            found[history.filter] = reason
    return found


def _not_finite(history: History) -> str:
    """Say from when on the state of a filter is not finite; empty if it is throughout."""
    columns = (
        history.sd,
        history.position,
        history.velocity_n,
        history.mat_nb,
        history.accel_bias_b,
        history.gyro_bias_b,
    )
    known = np.ones(len(history.time_ns), np.bool_)
    for column in columns:
        known &= np.isfinite(column.reshape(len(known), -1)).all(axis=1)
    if known.all():
        return ""
    first_s = (history.time_ns[np.argmin(known)] - history.time_ns[0]) / NS_PER_S
    return f"the state of {history.filter} is not finite from {first_s:.1f} s on"


def _gated_out(history: History) -> str:
    """Say that the gate of a filter rejected much of its main aiding, or was opened again often; empty if neither."""
    aiding = _main_aiding(history)
    if aiding is None:
        return ""
    count = int(aiding.rejected.sum())
    total = len(aiding.rejected)
    if count > max(FEW, (MANY_REJECTED + aiding.by_chance) * total):
        return f"{history.filter} rejected {count} of {total} {aiding.name}"
    # The filter diverges again and again, and is reset each time.
    reopened = len(history.reopened_ns)
    by_chance = aiding.by_chance**aiding.reopen_after
    if reopened > max(1.0, (MANY_REOPENED + by_chance) * total):
        return (
            f"{history.filter} diverged and was set to the DVL again {reopened} times "
            f"in {total} {aiding.name}"
        )
    return ""


class _MainAiding(NamedTuple):
    """What keeps a filter from drifting: the pings of the beams, else the velocities, else its first aiding."""

    name: str
    rejected: Mask  # (m,), by the gate
    by_chance: float  # probability that the gate rejects one of a consistent filter
    reopen_after: int  # rejections in a row after which the filter is set to the DVL


def _main_aiding(history: History) -> _MainAiding | None:
    """Return the main aiding of a filter; None if it has none."""
    used = [met for met in history.innovations if is_used(met.measurement)]
    beams = [met for met in used if is_beam(met.measurement)]
    if beams:
        # A ping is rejected if all its valid beams are; by chance, at most as often as one beam.
        return _MainAiding(
            "pings", _rejected_pings(beams), _chance(beams[0]), beams[0].reopen_after
        )
    if not used:
        return None
    lead = used[0]
    for met in used:
        if met.measurement == "velocity":
            lead = met
            break
    name = f"{lead.measurement} innovations"
    return _MainAiding(name, rejected(lead), _chance(lead), lead.reopen_after)


def _chance(met: Innovations) -> float:
    """Return how probable it is that the gate rejects an innovation of a consistent filter."""
    return float(chdtrc(met.dof, met.gate))


def _rejected_pings(beams: Sequence[Innovations]) -> Mask:
    """Find the pings of which the gate rejected all beams, shape (pings,)."""
    times, ping = np.unique(np.concatenate([beam.time_ns for beam in beams]), return_inverse=True)
    is_rejected = np.concatenate([rejected(beam) for beam in beams])
    pings = np.ones(len(times), np.bool_)
    pings[ping[~is_rejected]] = False
    return pings


def misfit(name: str, tables: Tables) -> str:
    """Say that a baseline predicts errors of another size than it has, so that nothing can be judged by it.

    Empty if the mean NIS per degree of freedom of its DVL is between `SMALLEST_PER_DOF` and `LARGEST_PER_DOF`, and the
    NEES of its settled errors too, or where it has none of these.
    """
    return _misfit_by_innovations(name, tables.consistency) or _misfit_by_errors(
        name, tables.credibility
    )


def _misfit_by_innovations(name: str, rows: Sequence[ConsistencyRow]) -> str:
    for row in rows:
        is_dvl = row.measurement == "velocity" or is_beam(row.measurement)
        if row.filter != name or not is_dvl or not row.dof:
            continue
        size = finite(row.mean_nis) / row.dof
        if not size > 0.0 or row.verdict == Consistency.INSUFFICIENT:
            continue
        if SMALLEST_PER_DOF <= size <= LARGEST_PER_DOF:
            continue
        found = f"NIS / dof of its {row.measurement} is {size:.2g}, expected 1"
        off = f"the noise variance of {name} is {_off(size)} ({found})"
        return f"{off}; without a preset or [noise] it is fitted, and --control fits it, too"
    return ""


def _misfit_by_errors(name: str, rows: Sequence[CredibilityRow]) -> str:
    for row in rows:
        is_sized = row.verdict in (Consistency.OVERCONFIDENT, Consistency.CONSERVATIVE)
        if row.filter != name or row.quantity not in SETTLED or not is_sized:
            continue
        size = finite(row.mean_nees) / row.dof
        if not size > 0.0:
            continue
        part = row.quantity.removeprefix(SETTLED_PREFIX)
        found = f"NEES / dof of its {part} against the reference is {size:.2g}, expected 1"
        return f"the variance that {name} predicts is {_off(size)} ({found}); --control fits it"
    return ""


def _off(size: float) -> str:
    """Say how far off a variance is, by NIS or NEES over its degrees of freedom."""
    if size < 1.0:
        return f"{1.0 / size:.0f} times too large"
    return f"{size:.0f} times too small"


def misread(name: str, rows: Sequence[ConsistencyRow]) -> str:
    """Name a sensor other than the DVL whose innovations are far larger than a candidate expects; empty if none is.

    It has other units, axes or a clock than the settings say, and a position may not show what comes of it.
    """
    others = [
        row for row in rows if row.measurement != "velocity" and not is_beam(row.measurement)
    ]
    return surprised(name, [row for row in others if row.measurement not in DVL_AIDING])


def surprised(name: str, rows: Sequence[ConsistencyRow]) -> str:
    """Name a sensor whose innovations are far larger than its filter expects; empty if there is none."""
    for row in rows:
        if row.filter != name or not is_used(row.measurement):
            continue
        nis = finite(row.mean_nis)
        if nis > LARGEST_PER_DOF * row.dof:
            return (
                f"the {row.measurement} innovations of {name} are far too large "
                f"(NIS {nis:.3g}, expected {row.dof})"
            )
    return ""


def far_off(
    history: History,
    baseline: History,
    errors: Mapping[str, ReferenceErrors],
    rows: Sequence[ReferenceErrorRow],
) -> str:
    """Say that a filter is far off with the DVL available; empty if it is not.

    Errors from DVL outages do not count, unless the DVL is silent for more than half of the time.
    """
    statuses = [row.status for row in rows if row.quantity == "position_h_pct"]
    if history.filter not in errors or ReferenceStatus.COMPARED not in statuses:
        return ""
    found = errors[history.filter]
    if not found.distance_m > 0.0:
        return ""
    known = np.isfinite(found.position_error_ned_m[:, :2]).all(axis=1)
    time_ns = np.append(baseline.time_ns[0], found.time_ns[known])
    steps_m = np.diff(found.position_error_ned_m[known, :2], axis=0, prepend=[[0.0, 0.0]])
    ping_ns = _ping_ns(baseline)
    if len(ping_ns) > 1:
        seen_ns = np.unique(np.concatenate([time_ns[:1], ping_ns, time_ns[-1:]]))
        longest_ns = OUTAGE * float(np.median(np.diff(ping_ns)))
        silent = in_pauses(time_ns[:-1], time_ns[1:], seen_ns, longest_ns)
        if 2 * np.diff(time_ns)[silent].sum() <= time_ns[-1] - time_ns[0]:
            steps_m[silent] = 0.0
    square_m2 = np.sum(np.cumsum(steps_m, axis=0) ** 2) / max(len(steps_m), 1)
    error_pct = 100.0 * np.sqrt(square_m2) / found.distance_m
    if error_pct > FARTHEST_PCT:
        return f"the position error of {history.filter} is {error_pct:.3g} % of the distance"
    return ""


def _ping_ns(history: History) -> TimeNs:
    """Return the times of the DVL's pings that a filter met."""
    pings = [np.empty(0, np.int64)]
    for met in history.innovations:
        if met.measurement == "velocity" or is_beam(met.measurement):
            pings.append(met.time_ns)
    return np.unique(np.concatenate(pings))


# --- The verdict on one dive.


def evaluated_candidates(
    histories: tuple[History, ...],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter; empty without a reference
    tables: Tables,
    notes: Sequence[Note],  # of the dive
    *,
    primary: str = "",  # the quantity that the settings name
    not_repeatable: Mapping[str, str] = MappingProxyType({}),  # by candidate, why it is not
    start: str = "",  # what the heading at the start comes from, see `sentences.start_of`
) -> tuple[Tables, dict[str, CandidateVerdict]]:
    """Return the verdict on each candidate. Evidence of those that are not evaluated decides nothing."""
    baseline, *candidates = (history.filter for history in histories)
    unsound = not_evaluated(histories, errors, tables, notes)
    varying = {name: reason for name, reason in not_repeatable.items() if name not in unsound}
    by_depth = _aided_by_its_depth(histories, notes)
    evidence = []
    for name in candidates:
        rows = [row for row in tables.evidence if row.filter == name]
        if baseline in by_depth or name in by_depth:
            rows = [row for row in rows if row.quantity != "depth"]
        if name in unsound or name in varying:
            rows = [replace(row, role=Role.SHOWN) for row in rows]
        evidence += rows
    tables = replace(tables, evidence=evidence)
    return tables, verdicts(tables, baseline, candidates, unsound, primary, varying, start)


def _aided_by_its_depth(histories: Sequence[History], notes: Sequence[Note]) -> set[str]:
    """Return the filters that are aided by the depth that the reference is made of: it is no evidence on them."""
    if "depth" not in OfReference.noted(notes).sensors:
        return set()
    found = set()
    for history in histories:
        if any(met.measurement == "depth" for met in history.innovations):
            found.add(history.filter)
    return found


def verdicts(
    tables: Tables,
    baseline: str,
    candidates: Sequence[str],
    # by candidate what keeps it from being evaluated, from `not_evaluated`
    unsound: Mapping[str, str],
    primary: str = "",  # the quantity that the settings name
    varying: Mapping[str, str] = MappingProxyType({}),  # by candidate, why it does not repeat
    start: str = "",  # what the heading at the start comes from
) -> dict[str, CandidateVerdict]:
    """Return the verdict on each candidate, by name."""
    found = {}
    for candidate in candidates:
        predicted_pct = mean_over_nine(tables.improvement, candidate)
        evidence = [row for row in tables.evidence if row.filter == candidate]
        reason = unsound.get(candidate, "") or varying.get(candidate, "")
        dives = [evidence]
        if reason:
            dives = []
        answer = pooled_candidate(
            candidate,
            baseline,
            dives,
            1,
            [predicted_pct],
            [reason],
            primary=primary or primary_of(dives),
            not_repeatable=int(candidate in varying),
        )
        changes = [
            finite(row.improvement_pct)
            for row in tables.reference_error
            if row.filter == candidate
            and row.status == ReferenceStatus.COMPARED
            and row.quantity in COMPARED
        ]
        trust = trust_sentence(tables, candidate, baseline)
        found[candidate] = CandidateVerdict(
            sentence=f"{paragraph(answer, start)} {trust}",
            verdict=answer.verdict,
            reason=reason,
            primary=answer.primary,
            consistency=consistency_of(tables.consistency, candidate),
            mean_improvement_pct=predicted_pct,
            mean_convergence_improvement_pct=mean_over_nine(tables.convergence, candidate),
            reference_improvement_pct=median_of(changes),
            credibility=credibility_of(tables.credibility, candidate),
            prediction=answer.prediction,
            mean_convergence_unchanged_pct=unchanged_over_nine(tables.convergence, candidate),
            mean_nearest_approach_improvement_pct=nearest_over_nine(tables.convergence, candidate),
        )
    return found


def not_evaluated_notes(verdicts: Mapping[str, CandidateVerdict]) -> tuple[Note, ...]:
    """Note the candidates without a verdict, so that a replay that may have no warnings fails."""
    notes = []
    for name, found in verdicts.items():
        if found.verdict in WITHOUT_VERDICT:
            notes.append(
                note(
                    "not_evaluated",
                    filter=name,
                    verdict=found.verdict,
                    reason=found.reason,
                )
            )
    return tuple(notes)


def trust_sentence(tables: Tables, candidate: str, baseline: str) -> str:
    """Say whether candidate and baseline are consistent, by innovations, errors and the outage test.

    If the candidate is aided by a sensor other than the DVL, the sentence has the NIS/dof of each of its sensors.
    """
    rows = [row for row in tables.consistency if row.measurement == "velocity" and row.dof]
    under_way = {row.filter: finite(row.mean_nis) / row.dof for row in rows}
    alarm = outage_alarm(tables.outage, (baseline, candidate), under_way)
    consistency_words = _trust(tables, candidate)
    baseline_trust = _trust(tables, baseline)
    if consistency_words == Consistency.NOT_AVAILABLE:
        return f"{candidate} reports no sigma, {baseline} is {baseline_trust}.{alarm}"
    sentence = f"Both filters are {consistency_words}."
    if consistency_words != baseline_trust:
        sentence = f"{candidate} is {consistency_words}, {baseline} {baseline_trust}."
    elif consistency_words == Consistency.INSUFFICIENT:
        sentence = "Both filters have insufficient data for a consistency test."
    used = [
        row for row in tables.consistency if row.filter == candidate and is_used(row.measurement)
    ]
    if not all(row.measurement in DVL_AIDING or is_beam(row.measurement) for row in used):
        sizes = ", ".join(
            f"{row.measurement} {finite(row.mean_nis) / row.dof:.3g}" for row in used
        )
        sentence = f"{sentence} NIS / dof of {candidate}: {sizes}."
    return f"{sentence}{alarm}"


def _trust(tables: Tables, name: str) -> str:
    """Join the consistency of innovations and of errors: one word if they agree or only one is known."""
    consistency = consistency_of(tables.consistency, name)
    credibility = credibility_of(tables.credibility, name)
    if credibility == Consistency.INSUFFICIENT or credibility not in WORST_FIRST:
        return consistency
    where = _groups_with(tables, name, credibility)
    if consistency in (Consistency.NOT_AVAILABLE, Consistency.INSUFFICIENT):
        return f"{credibility}{where} against the reference"
    if consistency == credibility:
        if where:
            return f"{consistency} by the innovations, and{where} against the reference"
        return consistency
    return f"{consistency} by the innovations and {credibility}{where} against the reference"


def _groups_with(tables: Tables, name: str, word: str) -> str:
    """Name the groups of states of a filter that have the worst verdict; empty where all of them have it."""
    groups = [
        row
        for row in tables.credibility
        if row.filter == name and row.quantity in ALL_CREDIBILITY_GROUPS
    ]
    tested = [row for row in groups if row.verdict in VERDICTS_BEST_FIRST]
    worst = [row.quantity.replace("_", " ") for row in tested if row.verdict == word]
    if len(worst) == len(tested):
        return ""
    return f" in {' and '.join(worst)}"
