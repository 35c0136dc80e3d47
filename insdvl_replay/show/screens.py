"""The terminal screens of a run: the answer for each candidate, then the evidence, then the dives one by one."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.errors import counted, natural_key
from insdvl_replay.core.quantities import WITHOUT_VERDICT, is_beam, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import EvidenceRow, PooledRow, finite, share_text
from insdvl_replay.core.words import GateStatus, Role, Severity, Verdict
from insdvl_replay.document.parts import (
    Callout,
    Code,
    DisplayTable,
    Part,
    Sentences,
    Title,
)
from insdvl_replay.document.tables import (
    MISSING,
    ShownColumn,
    significant,
    table_of,
)
from insdvl_replay.evaluation.answers import EVERY_DIVE, CandidateAnswer
from insdvl_replay.evaluation.notes import is_noise_far_off
from insdvl_replay.evaluation.sentences import (
    answer_lines,
    assay_line,
    headline,
    interval_text,
    ratio_text,
    shouted,
    word_of,
)
from insdvl_replay.evaluation.verdicts import consistency_of, trust_sentence
from insdvl_replay.show.answers import (
    TONES,
    Failure,
    Outcome,
    against_control,
    answers_of,
    assay_of,
    candidate_names,
    chosen_rows,
    evidence_cells,
    has_reference,
    initial_text,
    of_filter,
    predicted_change,
    predicted_unchecked,
    reports_of,
    start_text,
    unchecked_delay,
    verdict_in_table,
)
from insdvl_replay.show.dive import NO_REFERENCE, headline_table, line_alone, track_fit_line
from insdvl_replay.show.dives import table_alone


def quiet_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """Return one line for each candidate, over all dives; of a filter alone one for each dive."""
    reports = reports_of(outcomes)
    lines = [f"{report.log.name}, {line_alone(report)}" for report in reports if not report.filters]
    for answer in answers_of(reports):
        said = headline(answer)
        reason = f": {answer.reason}" if answer.verdict in WITHOUT_VERDICT else ""
        lines.append(f"{answer.filter} {said}{reason}")
    return lines


# --- The parts that both screens have.

MOST_ANSWERS: Final = 2  # More candidates have a row of a table each.
MOST_COLUMNS: Final = 3  # More candidates have no common table of evidence.
MOST_ROWS: Final = {
    1: 8,
    2: 4,
    3: 4,
}  # Evidence rows of several dives, by the number of candidates.
MOST_ROWS_OF_DIVE: Final = 3


def _answer_parts(
    answers: Sequence[CandidateAnswer], initial: str, start: str, reports: Sequence[Report]
) -> Iterator[Part]:
    """Yield verdict, how far it acts, convergence, prediction, and what the dives can find, of each candidate.

    The start is named once.
    """
    if len(answers) > MOST_ANSWERS:
        yield from (Sentences(()), _answer_table(answers))
        yield from ([f"start: {start}"] if start else [])
        return
    lines: list[str | Callout] = []
    for answer in answers:
        said = f"{answer.filter} against {answer.baseline}: {headline(answer)}"
        lines.append(Callout(said, TONES.get(answer.verdict, "")))
        lines += answer_lines(answer, initial, start)
        if answer.verdict not in WITHOUT_VERDICT:
            start = ""
        if answer.verdict == Verdict.NOT_EVALUATED:
            lines += _in_spite_of_misfit(answer.filter, reports)
    if lines:
        yield Sentences(tuple(lines))


def _in_spite_of_misfit(name: str, reports: Sequence[Report]) -> Iterator[str]:
    """Yield what can be said of a candidate beside a baseline whose noise is far off."""
    fitted = against_control(reports, name)
    if fitted is not None:
        yield f"against {fitted.baseline}, whose noise is fitted: {headline(fitted)}"
    if predicted := predicted_unchecked(reports, name):
        yield predicted


def _answer_table(answers: Sequence[CandidateAnswer]) -> DisplayTable:
    """Return many candidates, a row each."""
    rows = []
    for answer in answers:
        predicted = (MISSING, "") if answer.verdict in WITHOUT_VERDICT else predicted_change(answer)
        warned = (
            ", ".join(f"{label(row.quantity)} {row.verdict}" for row in answer.warnings)
            or answer.reason
        )
        acting = answer.decisive
        acts = share_text(acting.acts) if acting is not None else MISSING
        cells = evidence_cells(answer)
        rows.append(
            (
                answer.filter,
                word_of(answer),
                *cells,
                acts,
                answer.settling or MISSING,
                *predicted,
                warned,
            )
        )
    baselines = " or ".join(dict.fromkeys(answer.baseline for answer in answers))
    header = (
        *(
            "filter",
            f"against {baselines}",
            "decides by",
            "ratio",
            "interval",
            "acts",
            "convergence",
        ),
        *("predicted sigma", "", ""),
    )
    return DisplayTable("", header, "lllrrrlrll", tuple(rows), spare=(6, (7, 8), 9, 5, (2, 3)))


def _evidence_table(answers: Sequence[CandidateAnswer], title: str) -> Iterator[DisplayTable]:
    """Yield the evidence: of one candidate with intervals, of several side by side."""
    evaluated = [answer for answer in answers if answer.verdict not in WITHOUT_VERDICT]
    if not evaluated or len(answers) > MOST_COLUMNS:
        return
    known = [row for answer in evaluated for row in answer.known]
    is_one_dive = all(answer.dives == 1 for answer in answers)
    rows = chosen_rows(known, MOST_ROWS_OF_DIVE if is_one_dive else MOST_ROWS[len(answers)])
    if not rows:
        return
    if len(answers) > 1:
        yield _side_by_side(evaluated, list(dict.fromkeys(row.quantity for row in rows)), title)
        return
    [answer] = answers
    columns: list[ShownColumn] = [
        (title, "l", "quantity:label"),
        ("", "l", "unit"),
        (answer.baseline, "r", "baseline:value"),
        (answer.filter, "r", "value:value"),
        ("ratio", "r", lambda row: ratio_text(row.ratio)),
    ]
    if answer.dives > 1:
        columns += [
            ("interval", "r", interval_text),
            ("won", "r", lambda row: f"{row.dives_won}/{row.dives}"),
        ]
    columns.append(("acts", "r", "acts:share"))
    if answer.dives > 1:
        columns += [("", "l", verdict_in_table), ("", "l", _role_text)]
        yield table_of("", rows, columns, VALUES_ARE, spare=(9, 7, (1, 2, 3), 6))
    else:
        yield table_of("", rows, columns, spare=(5, (1, 2, 3)))


VALUES_ARE: Final = (
    "values: medians over the dives, from the starts that they had; convergence: from drawn starts"
)


def _role_text(row: PooledRow) -> str:
    return {Role.PRIMARY: "decides", Role.SECONDARY: "can warn", Role.VETO: "can warn"}.get(
        Role(row.role), ""
    )


def _side_by_side(
    answers: Sequence[CandidateAnswer], quantities: Sequence[str], title: str
) -> DisplayTable:
    """Return ratio and verdict of several candidates in the same quantities, with the values where there is room."""
    found = {(answer.filter, row.quantity): row for answer in answers for row in answer.known}
    cells = []
    for quantity in quantities:
        rows = [found.get((answer.filter, quantity)) for answer in answers]
        known = next(row for row in rows if row is not None)
        texts = [label(quantity), known.unit, significant(known.baseline, 3)]
        for row in rows:
            texts += (
                [significant(row.value, 3), ratio_text(row.ratio), verdict_in_table(row)]
                if row
                else [MISSING] * 3
            )
        cells.append(tuple(texts))
    heads = (head for answer in answers for head in ("value", answer.filter, ""))
    header = (f"{title}: ratio", "", answers[0].baseline, *heads)
    values = (1, 2, *range(3, len(header), 3))
    return DisplayTable("", header, f"llr{'rrl' * len(answers)}", tuple(cells), spare=(values,))


# --- One dive: with one candidate at most 24 lines of 80 columns.


def dive_screen(report: Report, page: str) -> list[Part]:
    """Return the screen of one dive, whose page is at ``page``."""
    answers = answers_of([report])
    notes = f", {counted(len(report.notes), 'note')}" if report.notes else ""
    return [
        Title(_facts(report)),
        *_answer_parts(answers, initial_text(report.config), start_text([report]), [report]),
        *([] if report.filters else [line_alone(report)]),
        *_evidence_table(answers, "this dive"),
        *_assay_parts([report], answers),
        *_trust_lines(report),
        *headline_table(report),
        *track_fit_line(report),
        *(() if has_reference(report) else (NO_REFERENCE,)),
        *_delay_line([report]),
        Code(f"all tables{notes}: -v   page: {page}", ""),
    ]


def _delay_line(reports: Sequence[Report]) -> list[str]:
    """Say that the delay of the reference was not checked, where it was not."""
    line = unchecked_delay(reports)
    if line:
        return [line]
    return []


def _trust_lines(report: Report) -> list[str]:
    """Say of each candidate whether it is consistent, and how large its innovations are if it is the only one."""
    if len(report.filters) > MOST_ANSWERS:
        return []
    lines = []
    is_far_off = is_noise_far_off(report.tables, report.baseline)
    for name in (
        name for name, found in report.filters.items() if found.verdict not in WITHOUT_VERDICT
    ):
        sizes = " Try --control, which fits the noise." if is_far_off else ""
        nis = next(
            (row for row in of_filter(name, report.tables.evidence) if row.quantity == "nis"), None
        )
        if nis is not None and len(report.filters) == 1:
            values = f"{report.baseline} {significant(nis.baseline, 3)}, {name} {significant(nis.value, 3)}"
            sizes = (
                f" {label(nis.quantity)}: {values}{', expected 1.' if is_far_off else '.'}{sizes}"
            )
        lines.append(f"{trust_sentence(report.tables, name, report.baseline)}{sizes}")
    return list(dict.fromkeys(lines))


def _facts(report: Report) -> str:
    """Return a line with what was replayed."""
    tables = report.tables
    duration_s = report.log.duration_s
    starts = _starts(tables.evidence)
    # The first filter that takes velocities, or beams where none does.
    rows = [row for row in tables.consistency if row.measurement == "velocity"][:1]
    kind = "velocities" if rows else "beams"
    if not rows:
        beams = [row for row in tables.consistency if is_beam(row.measurement)]
        rows = [row for row in beams if row.filter == beams[0].filter]
    rejected = sum(row.rejected for row in rows)
    met = (
        f"{sum(row.used for row in rows) + rejected} {kind}, {rejected} rejected"
        if rows
        else "no velocities"
    )
    # An onboard solution may cover only a part of the dive. The baseline is compared over all of it.
    baseline = [row.samples for row in of_filter(report.baseline, tables.drift)]
    compared = max([row.samples for row in tables.reference_error] + baseline, default=0)
    known = has_reference(report)
    reference = f"reference {compared / duration_s:.2g} Hz" if known else "no reference"
    begun = [counted(starts, "start")] if starts and known else []
    return f"{report.log.name}: {', '.join([f'{duration_s:.0f} s', met, reference, *begun])}"


def _starts(rows: Sequence[EvidenceRow]) -> int:
    """Return how many starts the evidence is from: the dive's own, and those that were drawn for convergence."""
    if not rows:
        return 0
    drawn = (row.starts for row in rows if row.evidence == "convergence")
    return 1 + max(drawn, default=0)


# --- Several dives: the pooled evidence, then a row for each dive.

MOST_DIVES: Final = 20  # With more dives, only the failed and the worst have rows.
MOST_FAILED = 8
WORST = 3
MOST_CODES = 3
FAILED: Final = GateStatus.FAILED  # Printed instead of a verdict.


def dives_screen(outcomes: Sequence[Outcome], index: str) -> list[Part]:
    """Return the screen of several dives, in the order of the logs, whose page is at ``index``."""
    reports = reports_of(outcomes)
    answers = answers_of(reports)
    pooled = [answer for answer in answers if answer.known and answer.log == EVERY_DIVE]
    initial = initial_text(reports[0].config) if reports else ""
    return [
        Title(_facts_of_dives(outcomes)),
        *(note.text for note in distinct_dives(reports)[1]),
        *_answer_parts(answers, initial, start_text(reports), reports),
        *(
            part
            for table in _evidence_table(pooled, "all dives")
            for part in (Sentences(()), table)
        ),
        Sentences(()),
        _dives_table(outcomes, {answer.filter: answer for answer in answers})
        if answers
        else table_alone(outcomes),
        *_assay_parts(reports, answers),
        *_consistency_counts(reports),
        *_delay_line(reports),
        Code(f"all tables: -v   page: {index}", ""),
    ]


def _assay_parts(reports: Sequence[Report], answers: Sequence[CandidateAnswer]) -> Iterator[Part]:
    """Yield what the dives could have shown: a table of controls by quantities, and which the primary one saw."""
    primary = next((answer.primary for answer in answers if answer.primary), "")
    rows = assay_of(reports, primary)
    if not rows:
        return
    yield Sentences(())
    yield assay_table(rows)
    yield assay_line(rows)


def assay_table(rows: Sequence[PooledRow]) -> DisplayTable:
    """Return the ratio and the word of each control, by quantity, those that decide or can warn."""
    shown_roles = (Role.PRIMARY, Role.SECONDARY)
    quantities = list(dict.fromkeys(row.quantity for row in rows if row.role in shown_roles))
    found = {(row.filter, row.quantity): row for row in rows}
    cells = []
    for control in dict.fromkeys(row.filter for row in rows):
        texts = [control]
        for quantity in quantities:
            row = found.get((control, quantity))
            word = verdict_in_table(row) if row is not None else ""
            texts.append(f"{ratio_text(row.ratio)} {word}".rstrip() if row is not None else MISSING)
        cells.append(tuple(texts))
    header = ("control", *(label(quantity).replace(" ", "\n", 1) for quantity in quantities))
    spare = tuple(range(len(header) - 1, 2, -1))
    return DisplayTable("", header, f"l{'l' * len(quantities)}", tuple(cells), spare=spare)


def _facts_of_dives(outcomes: Sequence[Outcome]) -> str:
    """Return a line with the number of dives, of those that failed, and of those with warnings."""
    reports = reports_of(outcomes)
    said = [counted(len(outcomes), "dive"), f"{len(outcomes) - len(reports)} failed"]
    codes = [
        {note.code for note in report.notes if note.severity == Severity.WARNING}
        for report in reports
    ]
    if counts := Counter(code for found in codes for code in found):
        named = [f"{code} {count}" for code, count in counts.most_common(MOST_CODES)]
        named += [f"{len(counts) - MOST_CODES} more"] if len(counts) > MOST_CODES else []
        said.append(f"warnings on {sum(map(bool, codes))}: {', '.join(named)}")
    return ", ".join(said)


def _consistency_counts(reports: Sequence[Report]) -> Iterator[str]:
    """Yield a line with the number of dives with each consistency of the innovations, for each filter."""
    texts = []
    for name in dict.fromkeys(
        name for report in reports for name in (report.baseline, *report.filters)
    ):
        tables = [
            report.tables.consistency
            for report in reports
            if name in (report.baseline, *report.filters)
        ]
        words = Counter(consistency_of(table, name) for table in tables)
        texts.append(
            f"{name} {', '.join(f'{count} {word}' for word, count in words.most_common())}"
        )
    far_off = sum(is_noise_far_off(report.tables, report.baseline) for report in reports)
    advice = (
        f". The noise settings are far off on {counted(far_off, 'dive')}: try --control"
        if far_off
        else ""
    )
    if texts:
        yield f"consistency (NIS): {'; '.join(texts)}{advice}"


def _dives_table(
    outcomes: Sequence[Outcome], answers: Mapping[str, CandidateAnswer]
) -> DisplayTable:
    """Return a row for each dive: of each candidate both values and the ratio in its primary quantity."""
    names = candidate_names(reports_of(outcomes))
    found: dict[tuple[str, str], EvidenceRow] = {}
    for report in reports_of(outcomes):
        for row in report.tables.evidence:
            if row.filter in answers and row.quantity == answers[row.filter].primary:
                found[report.log.name, row.filter] = row
    dives, footnote = _shown_dives(outcomes, found)
    if len(names) == 1:
        return _dives_of_one(dives, names[0], answers[names[0]], found, footnote)
    quantities = {name: label(answers[name].primary) or "evidence" for name in names}
    is_same = len(set(quantities.values())) == 1
    heads = [name if is_same else f"{name}\n{quantities[name]}" for name in names]
    first = f"{quantities[names[0]]}: ratio" if is_same else "dive by dive: ratio"
    cells = tuple(
        (dive, *(_ratio_on(outcome, name, found.get((dive, name))) for name in names))
        for dive, outcome in dives.items()
    )
    return DisplayTable("", (first, *heads), f"l{'r' * len(names)}", cells, footnote)


def _shown_dives(
    outcomes: Sequence[Outcome], found: Mapping[tuple[str, str], EvidenceRow]
) -> tuple[dict[str, Outcome], str]:
    """Return the dives that have a row, by name; of many dives those that failed and those with the largest ratios."""
    named = {
        outcome.log if isinstance(outcome, Failure) else outcome.log.name: outcome
        for outcome in outcomes
    }
    dives = {name: named[name] for name in sorted(named, key=natural_key)}
    if len(dives) <= MOST_DIVES:
        return dives, ""
    largest: dict[str, float] = {}
    for (dive, _), row in found.items():
        largest[dive] = max(largest.get(dive, 0.0), finite(row.ratio))
    worst = sorted(largest, key=lambda dive: -largest[dive])[:WORST]
    failed = [dive for dive, outcome in dives.items() if isinstance(outcome, Failure)][:MOST_FAILED]
    kept = {dive: outcome for dive, outcome in dives.items() if dive in (*failed, *worst)}
    left_out = len(outcomes) - len(kept)
    return kept, f"failed dives and the {WORST} largest ratios; {left_out} more are on the page"


def _dives_of_one(
    dives: Mapping[str, Outcome],
    name: str,
    answer: CandidateAnswer,
    found: Mapping[tuple[str, str], EvidenceRow],
    footnote: str,
) -> DisplayTable:
    """Return the dives of one candidate, with both values, the ratio, and how far the candidate acts."""
    cells = []
    for dive, outcome in dives.items():
        row = found.get((dive, name))
        if row is None or isinstance(outcome, Failure):
            cells.append((dive, MISSING, MISSING, _ratio_on(outcome, name, row), MISSING))
            continue
        acts = share_text(row.acts)
        values = significant(row.baseline, 3), significant(row.value, 3)
        cells.append((dive, *values, _ratio_on(outcome, name, row), acts))
    unit = next((f" [{row.unit}]" for row in found.values()), "")
    first = label(answer.primary) or "dive by dive"
    header = (first, f"{answer.baseline}{unit}", f"{name}{unit}", "ratio", "acts")
    return DisplayTable("", header, "lrrrr", tuple(cells), footnote, spare=((1, 2),))


def _ratio_on(outcome: Outcome, name: str, row: EvidenceRow | None) -> str:
    """Write the ratio of a candidate on a dive, or why there is none."""
    if isinstance(outcome, Failure):
        return FAILED
    if name in outcome.filters and outcome.filters[name].verdict in WITHOUT_VERDICT:
        return shouted(outcome.filters[name].verdict)
    if row is None:
        return MISSING
    return ratio_text(row.ratio)
