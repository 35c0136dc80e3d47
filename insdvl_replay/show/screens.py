"""The terminal screens of a run: the answer for each candidate, then the evidence, then the dives one by one."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Final

from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.errors import Note, counted, natural_key
from insdvl_replay.core.quantities import WITHOUT_VERDICT, is_beam, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import EvidenceRow, PooledRow, finite, share_text
from insdvl_replay.core.words import Consistency, GateStatus, Role, Severity, Verdict
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
from insdvl_replay.evaluation.answers import EVERY_DIVE, Answer, CandidateAnswer
from insdvl_replay.evaluation.notes import is_noise_far_off
from insdvl_replay.evaluation.sentences import (
    answer_lines,
    assay_line,
    headline,
    interval_text,
    plan_line,
    ratio_text,
    shouted,
    where_line,
    word_of,
)
from insdvl_replay.evaluation.verdicts import (
    consistency_of,
    credibility_of,
    trust_sentence,
)
from insdvl_replay.evaluation.where import notable
from insdvl_replay.show.answers import (
    GETTING_EVIDENCE,
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
    lacks_evidence,
    of_filter,
    predicted_change,
    predicted_unchecked,
    reports_of,
    start_text,
    unchecked_delay,
    verdict_in_table,
    where_of,
)
from insdvl_replay.show.dive import NO_REFERENCE, headline_table, line_alone, track_fit_line
from insdvl_replay.show.dives import table_alone


def quiet_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """Return one line for each candidate, over all dives; of a filter alone one for each dive."""
    reports = reports_of(outcomes)
    lines = []
    for report in reports:
        if not report.filters:
            lines.append(f"{report.log.name}, {line_alone(report)}")
    for answer in answers_of(reports):
        line = f"{answer.filter} {headline(answer)}"
        if answer.verdict in WITHOUT_VERDICT:
            line += f": {answer.reason}"
        lines.append(line)
    return lines


# --- The parts that both screens have.

MOST_ANSWERS: Final = 2  # More candidates have a row of a table each.
MOST_COLUMNS: Final = 3  # More candidates have no common table of evidence.
# Evidence rows of several dives, by the number of candidates.
MOST_ROWS: Final = {
    1: 8,
    2: 4,
    3: 4,
}
MOST_ROWS_OF_DIVE: Final = 3
VALUES_ARE: Final = (
    "values: medians over the dives, from the starts that they had; convergence: from drawn starts"
)


def _answer_parts(
    answers: Sequence[CandidateAnswer],
    initial: str,
    start: str,
    reports: Sequence[Report],
) -> Iterator[Part]:
    """Yield verdict, how far it acts, convergence, prediction, and what the dives can find, of each candidate.

    The start is named once.
    """
    where = _where_lines(answers, reports)
    if len(answers) > MOST_ANSWERS:
        yield Sentences(())
        yield _answer_table(answers)
        if start:
            yield f"start: {start}"
        yield from _plan_lines(answers)
        for answer in answers:
            if answer.filter in where:
                yield f"{answer.filter}: {where[answer.filter]}"
        return
    lines: list[str | Callout] = []
    for answer in answers:
        said = f"{answer.filter} against {answer.baseline}: {headline(answer)}"
        lines.append(Callout(said, TONES.get(answer.verdict, "")))
        lines += answer_lines(answer, initial, start)
        if answer.filter in where:
            lines.append(where[answer.filter])
        if answer.verdict not in WITHOUT_VERDICT:
            start = ""
        if answer.verdict == Verdict.NOT_EVALUATED:
            lines += _in_spite_of_misfit(answer.filter, reports)
    if any(lacks_evidence(answer) for answer in answers):
        lines.append(GETTING_EVIDENCE)
    if lines:
        yield Sentences(tuple(lines))


def _where_lines(answers: Sequence[CandidateAnswer], reports: Sequence[Report]) -> dict[str, str]:
    """Say where each candidate is better or worse than elsewhere, by its name; only of those of which it is known."""
    lines = {}
    for name, rows in where_of(reports, answers).items():
        line = where_line(notable(rows))
        if line:
            lines[name] = line
    return lines


def _plan_lines(answers: Sequence[CandidateAnswer]) -> Iterator[str]:
    """Yield what would decide the first candidate that is undecided, or none where all are decided."""
    for answer in answers:
        line = plan_line(answer)
        if line and answer.verdict == Verdict.UNDECIDED:
            yield f"for {answer.filter}: {line}"
            return


def _in_spite_of_misfit(name: str, reports: Sequence[Report]) -> Iterator[str]:
    """Yield what can be said of a candidate beside a baseline whose noise is far off."""
    fitted = against_control(reports, name)
    if fitted is not None:
        yield f"against {fitted.baseline}, whose noise is fitted: {headline(fitted)}"
    if predicted := predicted_unchecked(reports, name):
        yield predicted


def _answer_table(answers: Sequence[CandidateAnswer]) -> DisplayTable:
    """Return many candidates, a row each."""
    baselines = " or ".join(dict.fromkeys(answer.baseline for answer in answers))
    header = (
        "filter",
        f"against {baselines}",
        "decides by",
        "ratio",
        "interval",
        "acts",
        "convergence",
        "predicted sigma",
        "",  # whether the prediction is confirmed
        "",  # warnings, or the reason why it is not evaluated
    )
    rows = tuple(_answer_row(answer) for answer in answers)
    return DisplayTable("", header, "lllrrrlrll", rows, spare=(6, (7, 8), 9, 5, (2, 3)))


def _answer_row(answer: CandidateAnswer) -> tuple[str, ...]:
    acts = MISSING
    if answer.decisive is not None:
        acts = share_text(answer.decisive.acts)
    predicted = (MISSING, "")
    if answer.verdict not in WITHOUT_VERDICT:
        predicted = predicted_change(answer)
    warnings = [f"{label(row.quantity)} {row.verdict}" for row in answer.warnings]
    return (
        answer.filter,
        word_of(answer),
        *evidence_cells(answer),
        acts,
        answer.settling or MISSING,
        *predicted,
        ", ".join(warnings) or answer.reason,
    )


def evidence_tables(
    answers: Sequence[Answer],
    title: str,
    footnote: str = VALUES_ARE,
    *,
    most: int = 0,  # rows; 0: as many as a screen has room for
) -> Iterator[DisplayTable]:
    """Yield the evidence: of one candidate with intervals, of several side by side."""
    evaluated = [answer for answer in answers if answer.verdict not in WITHOUT_VERDICT]
    if not evaluated or len(answers) > MOST_COLUMNS:
        return
    if not most:
        most = MOST_ROWS[len(answers)]
        if all(answer.dives == 1 for answer in answers):
            most = MOST_ROWS_OF_DIVE
    known = list(chain.from_iterable(answer.known for answer in evaluated))
    rows = chosen_rows(known, most)
    if not rows:
        return
    if len(answers) > 1:
        quantities = list(dict.fromkeys(row.quantity for row in rows))
        yield _side_by_side(evaluated, quantities, title)
    elif answers[0].dives > 1:
        yield _evidence_over_dives(answers[0], rows, title, footnote)
    else:
        columns = [*_columns_of_values(answers[0], title), _ACTS]
        yield table_of("", rows, columns, spare=(5, (1, 2, 3)))


def _columns_of_values(answer: Answer, title: str) -> list[ShownColumn]:
    return [
        (title, "l", "quantity:label"),
        ("", "l", "unit"),
        (answer.baseline, "r", "baseline:value"),
        (answer.filter, "r", "value:value"),
        ("ratio", "r", lambda row: ratio_text(row.ratio)),
    ]


_ACTS: Final[ShownColumn] = ("acts", "r", "acts:share")


def _evidence_over_dives(
    answer: Answer, rows: Sequence[PooledRow], title: str, footnote: str
) -> DisplayTable:
    """Return the evidence on a candidate with intervals, verdicts and what they decide."""
    columns = [
        *_columns_of_values(answer, title),
        ("interval", "r", interval_text),
        ("won", "r", lambda row: f"{row.dives_won}/{row.dives}"),
        _ACTS,
        ("", "l", verdict_in_table),
        ("", "l", _role_text),
    ]
    return table_of("", rows, columns, footnote, spare=(9, 7, (1, 2, 3), 6))


_ROLES: Final = {Role.PRIMARY: "decides", Role.SECONDARY: "can warn", Role.VETO: "can warn"}


def _role_text(row: PooledRow) -> str:
    return _ROLES.get(Role(row.role), "")


def _side_by_side(
    answers: Sequence[Answer], quantities: Sequence[str], title: str
) -> DisplayTable:
    """Return ratio and verdict of several candidates in the same quantities, with the values where there is room."""
    found: dict[tuple[str, str], PooledRow] = {}
    for answer in answers:
        for row in answer.known:
            found[answer.filter, row.quantity] = row
    cells = []
    for quantity in quantities:
        rows = [found.get((answer.filter, quantity)) for answer in answers]
        cells.append(_row_of_several(quantity, rows))
    header = [f"{title}: ratio", "", answers[0].baseline]
    for answer in answers:
        header += ["value", answer.filter, ""]
    values = (1, 2, *range(3, len(header), 3))
    alignment = f"llr{'rrl' * len(answers)}"
    return DisplayTable("", tuple(header), alignment, tuple(cells), spare=(values,))


def _row_of_several(quantity: str, rows: Sequence[PooledRow | None]) -> tuple[str, ...]:
    """Return a quantity with its unit, the baseline's value, and value, ratio and verdict of each candidate."""
    [first, *_] = [row for row in rows if row is not None]
    cells = [label(quantity), first.unit, significant(first.baseline, 3)]
    for row in rows:
        if row is None:
            cells += [MISSING] * 3
        else:
            cells += [significant(row.value, 3), ratio_text(row.ratio), verdict_in_table(row)]
    return tuple(cells)


# --- One dive: with one candidate at most 24 lines of 80 columns.


def dive_screen(report: Report, page: str) -> list[Part]:
    """Return the screen of one dive, whose page is at ``page``."""
    answers = answers_of([report])
    parts: list[Part] = [Title(_facts(report))]
    parts += _answer_parts(answers, initial_text(report.config), start_text([report]), [report])
    if not report.filters:
        parts.append(line_alone(report))
    parts += evidence_tables(answers, "this dive")
    parts += _assay_parts([report], answers)
    parts += _trust_lines(report)
    parts += headline_table(report)
    parts += track_fit_line(report)
    if not has_reference(report):
        parts.append(NO_REFERENCE)
    parts += _delay_line([report])
    more = "all tables"
    if report.notes:
        more = f"all tables, {counted(len(report.notes), 'note')}"
    parts.append(Code(f"{more}: -v   page: {page}", ""))
    return parts


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
    is_far_off = is_noise_far_off(report.tables, report.baseline)
    lines = []
    for name, candidate in report.filters.items():
        if candidate.verdict in WITHOUT_VERDICT:
            continue
        line = trust_sentence(report.tables, name, report.baseline)
        if len(report.filters) == 1:
            line += _innovations_text(report, name, is_far_off=is_far_off)
        if is_far_off:
            line += " Try --control, which fits the noise."
        lines.append(line)
    return list(dict.fromkeys(lines))


def _innovations_text(report: Report, name: str, *, is_far_off: bool) -> str:
    """Say how large the innovations of a candidate and of the baseline are; empty where it is not known."""
    for row in of_filter(name, report.tables.evidence):
        if row.quantity == "nis":
            baseline = f"{report.baseline} {significant(row.baseline, 3)}"
            text = f" {label(row.quantity)}: {baseline}, {name} {significant(row.value, 3)}"
            if is_far_off:
                return f"{text}, expected 1."
            return f"{text}."
    return ""


def _facts(report: Report) -> str:
    """Return a line with what was replayed."""
    duration_s = report.log.duration_s
    facts = [f"{duration_s:.0f} s", _met_pings(report)]
    if has_reference(report):
        facts.append(f"reference {_times_compared(report) / duration_s:.2g} Hz")
        starts = _starts(report.tables.evidence)
        if starts:
            facts.append(counted(starts, "start"))
    else:
        facts.append("no reference")
    return f"{report.log.name}: {', '.join(facts)}"


def _starts(rows: Sequence[EvidenceRow]) -> int:
    """Return how many starts the evidence is from: the dive's own, and those that were drawn for convergence."""
    if not rows:
        return 0
    drawn = (row.starts for row in rows if row.evidence == "convergence")
    return 1 + max(drawn, default=0)


def _met_pings(report: Report) -> str:
    """Count what the first filter that takes velocities, or beams where none does, met of the DVL."""
    rows = report.tables.consistency
    beams = [row for row in rows if is_beam(row.measurement)]
    for row in rows:
        if row.measurement == "velocity":
            return f"{row.used + row.rejected} velocities, {row.rejected} rejected"
    if not beams:
        return "no velocities"
    own = of_filter(beams[0].filter, beams)
    rejected = sum(row.rejected for row in own)
    used = sum(row.used for row in own)
    return f"{used + rejected} beams, {rejected} rejected"


def _times_compared(report: Report) -> int:
    """Return the most times at which a filter is compared with the reference.

    An onboard solution may cover only a part of the dive. The baseline is compared over all of it.
    """
    samples = [row.samples for row in report.tables.reference_error]
    samples += [row.samples for row in of_filter(report.baseline, report.tables.drift)]
    return max(samples, default=0)


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
    initial = initial_text(reports[0].config) if reports else ""
    parts: list[Part] = [Title(_facts_of_dives(outcomes))]
    _, notes = distinct_dives(reports)
    parts += [_with_hint(note) for note in notes]
    parts += _answer_parts(answers, initial, start_text(reports), reports)
    pooled = [answer for answer in answers if answer.known and answer.log == EVERY_DIVE]
    for table in evidence_tables(pooled, "all dives"):
        parts += [Sentences(()), table]
    parts.append(Sentences(()))
    if answers:
        parts.append(_dives_table(outcomes, {answer.filter: answer for answer in answers}))
    else:
        parts.append(table_alone(outcomes))
    parts += _assay_parts(reports, answers)
    parts += _consistency_counts(reports)
    parts += _delay_line(reports)
    parts.append(Code(f"all tables: -v   page: {index}", ""))
    return parts


def _with_hint(note: Note) -> str:
    """Return a note on the dives together, with what to do about it."""
    if note.hint:
        return f"{note.text}; hint: {note.hint}"
    return note.text


def _assay_parts(reports: Sequence[Report], answers: Sequence[CandidateAnswer]) -> Iterator[Part]:
    """Yield what the dives could have shown: a table of controls by quantities, and which the primary one saw."""
    rows = assay_of(reports, _first_primary(answers))
    if rows:
        yield Sentences(())
        yield assay_table(rows)
        yield assay_line(rows)


def _first_primary(answers: Sequence[CandidateAnswer]) -> str:
    for answer in answers:
        if answer.primary:
            return answer.primary
    return ""


def assay_table(rows: Sequence[PooledRow]) -> DisplayTable:
    """Return the ratio and the word of each control, by quantity, those that decide or can warn."""
    quantities: list[str] = []
    controls: dict[str, dict[str, PooledRow]] = {}  # by name, then by quantity
    for row in rows:
        controls.setdefault(row.filter, {})[row.quantity] = row
        if row.role in (Role.PRIMARY, Role.SECONDARY) and row.quantity not in quantities:
            quantities.append(row.quantity)
    cells = []
    for control, own in controls.items():
        texts = [_assay_text(own.get(quantity)) for quantity in quantities]
        cells.append((control, *texts))
    header = ("control", *(label(quantity).replace(" ", "\n", 1) for quantity in quantities))
    spare = tuple(range(len(header) - 1, 2, -1))
    return DisplayTable("", header, f"l{'l' * len(quantities)}", tuple(cells), spare=spare)


def _assay_text(row: PooledRow | None) -> str:
    if row is None:
        return MISSING
    return f"{ratio_text(row.ratio)} {verdict_in_table(row)}".rstrip()


def _facts_of_dives(outcomes: Sequence[Outcome]) -> str:
    """Return a line with the number of dives, of those that failed, and of those with warnings."""
    reports = reports_of(outcomes)
    said = [counted(len(outcomes), "dive"), f"{len(outcomes) - len(reports)} failed"]
    dives_warned = 0
    counts = Counter[str]()  # of dives, by code
    for report in reports:
        codes = {note.code for note in report.notes if note.severity == Severity.WARNING}
        dives_warned += bool(codes)
        counts.update(sorted(codes))
    if counts:
        named = [f"{code} {count}" for code, count in counts.most_common(MOST_CODES)]
        if len(counts) > MOST_CODES:
            named.append(f"{len(counts) - MOST_CODES} more")
        said.append(f"warnings on {dives_warned}: {', '.join(named)}")
    return ", ".join(said)


def _consistency_counts(reports: Sequence[Report]) -> Iterator[str]:
    """Yield how many dives have each consistency of the innovations, for each filter; then of errors too large."""
    by_innovations = _words_on_dives(
        reports, lambda report, name: consistency_of(report.tables.consistency, name)
    )
    if not by_innovations:
        return
    far_off = 0
    for report in reports:
        far_off += is_noise_far_off(report.tables, report.baseline)
    line = f"consistency (NIS): {_counted_words(by_innovations)}"
    if far_off:
        line += f". The noise settings are far off on {counted(far_off, 'dive')}: try --control"
    yield line
    by_errors = _words_on_dives(
        reports, lambda report, name: credibility_of(report.tables.credibility, name)
    )
    for words in by_errors.values():
        if 2 * words[Consistency.OVERCONFIDENT] >= len(reports):
            yield f"errors against the reference (NEES): {_counted_words(by_errors)}"
            return


def _words_on_dives(
    reports: Sequence[Report], word_of_filter: Callable[[Report, str], str]
) -> dict[str, Counter[str]]:
    """Count the dives by the word that a filter has on each, by filter."""
    counts: dict[str, Counter[str]] = {}
    for report in reports:
        for name in (report.baseline, *report.filters):
            counts.setdefault(name, Counter()).update([word_of_filter(report, name)])
    return counts


def _counted_words(counts: Mapping[str, Counter[str]]) -> str:
    texts = []
    for name, words in counts.items():
        counted_words = [f"{count} {word}" for word, count in words.most_common()]
        texts.append(f"{name} {', '.join(counted_words)}")
    return "; ".join(texts)


def _dives_table(
    outcomes: Sequence[Outcome], answers: Mapping[str, CandidateAnswer]
) -> DisplayTable:
    """Return a row for each dive: of each candidate both values and the ratio in its primary quantity."""
    found: dict[tuple[str, str], EvidenceRow] = {}
    for report in reports_of(outcomes):
        for row in report.tables.evidence:
            if row.filter in answers and row.quantity == answers[row.filter].primary:
                found[report.log.name, row.filter] = row
    dives, footnote = _shown_dives(outcomes, found)
    names = candidate_names(reports_of(outcomes))
    if len(names) == 1:
        return _dives_of_one(dives, names[0], answers[names[0]], found, footnote)
    quantities = [label(answers[name].primary) or "evidence" for name in names]
    if len(set(quantities)) == 1:
        header = [f"{quantities[0]}: ratio", *names]
    else:
        header = ["dive by dive: ratio"]
        for name, quantity in zip(names, quantities, strict=True):
            header.append(f"{name}\n{quantity}")
    cells = []
    for dive, outcome in dives.items():
        ratios = [_ratio_on(outcome, name, found.get((dive, name))) for name in names]
        cells.append((dive, *ratios))
    return DisplayTable("", tuple(header), f"l{'r' * len(names)}", tuple(cells), footnote)


def _shown_dives(
    outcomes: Sequence[Outcome], found: Mapping[tuple[str, str], EvidenceRow]
) -> tuple[dict[str, Outcome], str]:
    """Return the dives that have a row, by name; of many dives those that failed and those with the largest ratios."""
    named: dict[str, Outcome] = {}
    for outcome in outcomes:
        if isinstance(outcome, Failure):
            named[outcome.log] = outcome
        else:
            named[outcome.log.name] = outcome
    dives = {name: named[name] for name in sorted(named, key=natural_key)}
    if len(dives) <= MOST_DIVES:
        return dives, ""
    largest: dict[str, float] = {}
    for (dive, _), row in found.items():
        largest[dive] = max(largest.get(dive, 0.0), finite(row.ratio))
    worst = sorted(largest, key=lambda dive: -largest[dive])[:WORST]
    failed = [dive for dive, outcome in dives.items() if isinstance(outcome, Failure)]
    chosen = {*failed[:MOST_FAILED], *worst}
    kept = {dive: outcome for dive, outcome in dives.items() if dive in chosen}
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
        values = (significant(row.baseline, 3), significant(row.value, 3))
        cells.append((dive, *values, _ratio_on(outcome, name, row), acts))
    unit = ""
    if found:
        [one, *_] = found.values()
        unit = f" [{one.unit}]"
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
