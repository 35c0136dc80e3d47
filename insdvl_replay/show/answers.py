"""The answers of reports as they are shown: the chosen rows of evidence, and their texts in tables."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final, Protocol, TypeVar

from msgspec.structs import replace

from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.errors import counted
from insdvl_replay.core.of_reference import is_independent
from insdvl_replay.core.quantities import (
    CONSISTENCY,
    DRAWN_HEADING,
    OUTAGE_WINDOWS_S,
    WITHOUT_VERDICT,
    label,
)
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import EvidenceRow, Number, PooledRow, WhereRow, finite
from insdvl_replay.core.words import DelayStatus, Prediction, ReferenceStatus, Role, Verdict
from insdvl_replay.document.tables import MISSING, percent
from insdvl_replay.evaluation.answers import (
    BAD,
    CONTROL,
    EVERY_DIVE,
    GOOD,
    NOTABLE_PCT,
    Answer,
    CandidateAnswer,
    CandidateOnDive,
    answer_over_dives,
    answers_together,
    assay_rows,
    levels_of,
    median_of,
    pooled_candidate,
    primary_of,
)
from insdvl_replay.evaluation.evidence import role_alone
from insdvl_replay.evaluation.interval import LEVEL
from insdvl_replay.evaluation.outage_test import SHORTEST_S
from insdvl_replay.evaluation.sentences import interval_text, ratio_text, start_of
from insdvl_replay.evaluation.verdicts import misfit
from insdvl_replay.evaluation.where import pooled_where

# By verdict: its colour.
TONES: Final[dict[str, str]] = {
    **dict.fromkeys(GOOD, "good"),
    **dict.fromkeys(BAD, "bad"),
    **dict.fromkeys(WITHOUT_VERDICT, "bad"),
}


@dataclass(frozen=True)
class Failure:
    """A log that could not be replayed, and why, in one sentence."""

    log: str
    reason: str


Outcome = Report | Failure


def reports_of(outcomes: Sequence[Outcome]) -> list[Report]:
    """Return the dives that were replayed."""
    return [outcome for outcome in outcomes if isinstance(outcome, Report)]


class _FilterRow(Protocol):
    @property
    def filter(self) -> str: ...


Row = TypeVar("Row", bound=_FilterRow)


def of_filter(name: str, rows: Iterable[Row]) -> list[Row]:
    """Return the rows of a filter."""
    return [row for row in rows if row.filter == name]


def has_reference(report: Report) -> bool:
    """Return whether the dive has a reference; early reports lack one of the two tables that show it."""
    words = {row.verdict for row in report.tables.credibility}
    words |= {row.status for row in report.tables.reference_error}
    return bool(words - {ReferenceStatus.NO_REFERENCE})


def unchecked_delay(reports: Sequence[Report]) -> str:
    """Say that the delay of the reference was not checked, where its velocities could warn otherwise; else empty.

    A reference whose turns and accelerations contradict each other has a warning of its own.
    """
    having = [report for report in reports if _has_velocity_rows(report)]
    statuses = list[DelayStatus]()
    for report in having:
        delay = report.reference_delay
        if delay is not None and delay.status in _UNCHECKED:
            statuses.append(delay.status)
    if not statuses:
        return ""
    why = " or ".join(dict.fromkeys(statuses))
    if len(having) == 1:
        return f"reference: delay not checked ({why}), so velocities cannot warn"
    dives = f"{len(statuses)} of {counted(len(having), 'dive')}"
    return f"reference: delay not checked on {dives} ({why}), so velocities cannot warn there"


_UNCHECKED: Final = (DelayStatus.LITTLE_MOTION, DelayStatus.NO_ATTITUDE)


def _has_velocity_rows(report: Report) -> bool:
    """Return whether velocities of the reference are compared."""
    return any(
        row.evidence == "accuracy" and row.quantity.startswith("velocity")
        for row in report.tables.evidence
    )


# --- A row of evidence.


def verdict_in_table(row: PooledRow) -> str:
    """Return the word of a row, in brackets if it neither decides nor warns; empty on one dive, which has none."""
    if row.dives <= 1:
        return ""
    if row.role == Role.SHOWN and row.verdict:
        return f"({row.verdict})"
    return row.verdict


def as_shown(row: PooledRow) -> PooledRow:
    """Return a row as tables show it."""
    return replace(row, verdict=verdict_in_table(row))


# Rows of evidence that are shown next to those that decide or warn, the most important first.
_CHOSEN: Final = (
    DRAWN_HEADING,
    "outage_60s",
    "velocity_along",
    "velocity_across",
    "drift_60s",
    "drift_30s",
    "position_end",
)


def chosen_rows(rows: Sequence[PooledRow], most: int) -> list[PooledRow]:
    """Choose rows for a short table: the one that decides, those that can warn, convergence, then others."""
    known = [row for row in rows if row.baseline is not None or row.value is not None]
    order = list(Role)

    def importance(row: PooledRow) -> tuple[int, bool]:
        return order.index(Role(row.role)), row.quantity not in _CHOSEN

    quantities = list(dict.fromkeys(row.quantity for row in sorted(known, key=importance)))[:most]
    return [row for row in known if row.quantity in quantities]


# --- An answer.


def evidence_cells(answer: Answer) -> tuple[str, str, str]:
    """Write the primary quantity, its ratio and its interval, for a table."""
    row = answer.decisive
    if row is None or answer.verdict in WITHOUT_VERDICT:
        return MISSING, MISSING, MISSING
    return label(row.quantity), ratio_text(row.ratio), interval_text(row)


def prediction_word(predicted_pct: Number, prediction: str) -> str:
    """Say in a word whether a predicted improvement is confirmed; empty if it is too small to be checked."""
    if not finite(predicted_pct) >= NOTABLE_PCT:
        return ""
    if prediction == Prediction.CONFIRMED:
        return Prediction.CONFIRMED
    return Prediction.NOT_CONFIRMED


def predicted_change(answer: CandidateAnswer) -> tuple[str, str]:
    """Write the predicted change of sigma, such as ``12.3 % smaller``, and whether it is confirmed."""
    pct = finite(answer.predicted_pct)
    if math.isnan(pct):
        return MISSING, ""
    direction = "larger" if pct < 0.0 else "smaller"
    return f"{percent(abs(pct))} {direction}", prediction_word(pct, answer.prediction)


def initial_text(config: Mapping[str, Any]) -> str:
    """Write how uncertain drawn starts are, by the settings of a report: level, heading, accelerometer bias."""
    initial = config.get("initial", {})
    misalignment_deg = initial.get("misalignment_sd_deg")
    if not misalignment_deg:
        return ""
    *level_deg, heading_deg = misalignment_deg
    text = f"level {max(level_deg):g} deg, heading {heading_deg:g} deg"
    bias_mg = initial.get("accel_bias_sd_mg")
    if isinstance(bias_mg, float | int):
        return f"{text}, {bias_mg:g} mg"
    return text


def start_text(reports: Sequence[Report]) -> str:
    """Say what the heading at the start of the dives comes from; empty for early reports."""
    return start_of(report.start_heading for report in reports if report.start_heading is not None)


# --- The answers of reports.


def lacking_evidence(report: Report) -> str:
    """Say what a dive lacks for evidence, and how much."""
    lacking = []
    if not has_reference(report):
        lacking.append("no reference")
    elif not any(row.status == ReferenceStatus.COMPARED for row in report.tables.reference_error):
        lacking.append("the reference covers too little")
    elif report.config.get("reference", {}).get("independent") is False:
        lacking.append("the reference is not independent")
    duration_s = report.log.duration_s
    if duration_s < SHORTEST_S:
        lacking.append(
            f"too short for the outage test (needs {SHORTEST_S} s, has {duration_s:.0f} s)"
        )
    elif not report.tables.outage:
        lacking.append(
            f"no {OUTAGE_WINDOWS_S[0]} s in which the DVL has no gap, for the outage test"
        )
    return ", and ".join(lacking) or "the filters have no common errors"


GETTING_EVIDENCE: Final = (
    "To get evidence: name a reference (reference.topic), "
    f"or replay dives of at least {SHORTEST_S} s."
)


def lacks_evidence(answer: CandidateAnswer) -> bool:
    """Return whether nothing was measured on any dive that could decide."""
    is_open = answer.verdict == Verdict.UNDECIDED and answer.decisive is None
    return is_open and bool(answer.reason)


def answers_of(reports: Sequence[Report]) -> list[CandidateAnswer]:
    """Return the answer for each candidate, over all dives that have it; copies of a dive count once.

    Several candidates share the error rate of one. Controls, and candidates without any effect, do not count.
    """
    if not reports:
        return []
    reports, _ = distinct_dives(reports)
    found = answers_together(
        candidate_names(reports),
        lambda name, level: _answer(reports, name, level),
        _evaluation(reports[0]).get("candidate", ""),
    )
    return [*found.values()]


def _answer(reports: Sequence[Report], name: str, level: float = LEVEL) -> CandidateAnswer:
    having = [report for report in reports if name in report.filters]
    dives = [_candidate_on(report, name) for report in having]
    answer = answer_over_dives(name, dives, primary=_named_primary(having), level=level)
    evaluated = [report for report in having if _is_evaluated(report, name)]
    # Why other dives are not evaluated is no reason of those that are.
    is_evaluated = answer.verdict not in WITHOUT_VERDICT
    if evaluated and is_evaluated and answer.decisive is None:
        (lacking, _), *_ = Counter(map(lacking_evidence, evaluated)).most_common(1)
        answer = replace(answer, reason=lacking)
    return answer


def _candidate_on(report: Report, name: str) -> CandidateOnDive:
    """Return what a result says of a candidate."""
    candidate = report.filters[name]
    return CandidateOnDive(
        log=report.log.name,
        baseline=report.baseline,
        vehicle=report.vehicle,
        verdict=candidate.verdict,
        reason=candidate.reason,
        predicted_pct=candidate.mean_improvement_pct,
        rows=of_filter(name, report.tables.evidence),
    )


def _evaluation(report: Report) -> Mapping[str, Any]:
    """Return the settings of the evaluation of a dive; early reports have fewer."""
    settings: Mapping[str, Any] = report.config.get("evaluation", {})
    return settings


def _named_primary(reports: Sequence[Report]) -> str:
    """Return the primary quantity that the settings name; empty if they name none."""
    if not reports:
        return ""
    named: str = _evaluation(reports[0]).get("primary", "")
    return named


def answer_on_dive(report: Report, name: str) -> CandidateAnswer:
    """Return the answer for a candidate on one dive."""
    return _answer([report], name)


def has_misfit(report: Report) -> bool:
    """Return whether nothing is evaluated on a dive since the noise of its baseline is far off."""
    return bool(misfit(report.baseline, report.tables))


def predicted_unchecked(reports: Sequence[Report], name: str) -> str:
    """State what a candidate predicts on dives whose baseline has a noise that is far off; empty without any."""
    smaller_pct = []
    faster_pct = []
    for report in reports:
        if name in report.filters and has_misfit(report):
            candidate = report.filters[name]
            smaller_pct.append(finite(candidate.mean_improvement_pct))
            faster_pct.append(finite(candidate.mean_convergence_improvement_pct))
    sigma_pct = median_of(smaller_pct)
    convergence_pct = median_of(faster_pct)
    if math.isnan(sigma_pct) or math.isnan(convergence_pct):
        return ""
    smaller = "smaller" if sigma_pct >= 0.0 else "larger"
    faster = "faster" if convergence_pct >= 0.0 else "slower"
    sigma = f"{percent(abs(sigma_pct))} {smaller} sigma"
    convergence = f"{percent(abs(convergence_pct))} {faster} convergence of it"
    return f"predicted: {sigma}, {convergence}. Neither is checked against errors."


def against_control(reports: Sequence[Report], name: str) -> CandidateAnswer | None:
    """Return the answer for a candidate against the control, whose noise is fitted; None without `--control`.

    It stands in for that against a baseline whose noise is far off. Both filters have an error against the same
    baseline, so their ratio is that of their own values.
    """
    if name == CONTROL:
        return None
    reports, _ = distinct_dives(reports)
    having = []
    for report in reports:
        if name in report.filters and CONTROL in report.filters and has_misfit(report):
            having.append(report)
    if not having:
        return None
    rows = [_rows_against_control(report, name) for report in having]
    return pooled_candidate(
        name,
        CONTROL,
        rows,
        len(having),
        primary=primary_of(rows, _named_primary(having)),
        vehicles=[report.vehicle for report in having],
    )


def _rows_against_control(report: Report, name: str) -> list[EvidenceRow]:
    """Return the rows of a candidate with the control's values for those of the baseline."""
    control = {row.quantity: row for row in of_filter(CONTROL, report.tables.evidence)}
    found = []
    for row in of_filter(name, report.tables.evidence):
        before = control.get(row.quantity)
        if before is None or row.evidence == CONSISTENCY or not finite(before.value) > 0.0:
            continue
        ratio = finite(row.value) / finite(before.value)
        role = role_alone(
            row.quantity,
            row.samples,
            independent=is_independent(report.config),
            delay=report.reference_delay,
        )
        changed = {
            "baseline": before.value,
            "ratio": ratio,
            "role": role,
            "moves": None,
            "acts": None,
        }
        found.append(replace(row, **changed))
    return found


def assay_of(reports: Sequence[Report], primary: str) -> list[PooledRow]:
    """Pool the controls of `run --assay` over all dives, for a primary quantity; no rows without an assay."""
    return assay_rows([report.tables.assay for report in reports if report.tables.assay], primary)


def where_of(
    reports: Sequence[Report], answers: Sequence[CandidateAnswer]
) -> dict[str, list[WhereRow]]:
    """Return the drift by what the vehicle does, over all dives, of each candidate that is evaluated on several."""
    found = dict[str, list[WhereRow]]()
    if not reports:
        return found
    reports, _ = distinct_dives(reports)
    levels = levels_of(answers, _evaluation(reports[0]).get("candidate", ""))
    for answer in answers:
        name = answer.filter
        if answer.log != EVERY_DIVE or answer.verdict in WITHOUT_VERDICT:
            continue
        evaluated = [report for report in reports if _is_evaluated(report, name)]
        rows = [of_filter(name, report.tables.where) for report in evaluated]
        vehicles = [report.vehicle for report in evaluated]
        found[name] = pooled_where(rows, level=levels[name], vehicles=vehicles)
    return found


def _is_evaluated(report: Report, name: str) -> bool:
    return name in report.filters and report.filters[name].verdict not in WITHOUT_VERDICT


def candidate_names(reports: Sequence[Report]) -> list[str]:
    """Return the candidates of all dives, each once."""
    return list(dict.fromkeys(chain.from_iterable(report.filters for report in reports)))


def baseline_names(reports: Sequence[Report]) -> str:
    """Return the baselines of all dives."""
    return " or ".join(sorted({report.baseline for report in reports}))
