"""The terminal screens of a run: the answer for each candidate, then the evidence, then the dives one by one."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from insdvl_replay.core.errors import counted, natural_key
from insdvl_replay.core.quantities import CONSISTENCY, is_beam, label
from insdvl_replay.core.result import Callout, Code, DisplayTable, Part, Report, Sentences, Title
from insdvl_replay.core.tables import EvidenceRow, PooledRow, finite
from insdvl_replay.core.words import GateStatus, Severity, Verdict
from insdvl_replay.evaluation.answers import EVERY_DIVE, FEWEST_SHOWN, NOTABLE_PCT, Piece, may_decide, reason_in_words
from insdvl_replay.evaluation.notes import is_noise_far_off
from insdvl_replay.evaluation.verdicts import consistency_of, trust_sentence
from insdvl_replay.show.answers import (
    TONES,
    AnyCandidate,
    Failure,
    Outcome,
    answer_on_dive,
    answers_of,
    baseline_names,
    candidate_names,
    chosen_rows,
    evidence_cells,
    evidence_text,
    has_reference,
    interval_text,
    of_filter,
    predicted_change,
    ratio_text,
    reason_undecided,
    reports_of,
    shouted,
    spoken_rows,
    verdict_counts,
    verdict_in_table,
    verdict_with_reason,
    would_decide,
)
from insdvl_replay.show.dive import NO_REFERENCE, headline_table, line_alone, over_starts, track_fit_line
from insdvl_replay.show.dives import table_alone
from insdvl_replay.show.document import MISSING, ShownColumn, decimal, significant, table_of

_NOT_CHECKED: Final = f"below {NOTABLE_PCT:.0f} %, not checked"


def quiet_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """Return one line for each candidate, over all dives; of a filter alone one for each dive."""
    lines = [f"{report.log.name}, {line_alone(report)}" for report in reports_of(outcomes) if not report.filters]
    for answer in answers_of(reports_of(outcomes)):
        start = f"{answer.filter} {shouted(answer.verdict)}"
        if answer.verdict == Verdict.NOT_EVALUATED:
            lines.append(f"{start} on {answer.where}: {answer.reason}")
        else:
            reason = f": {why}" if (why := reason_undecided(answer)) else ""
            text, word = predicted_change(answer)
            word = word if finite(answer.predicted_pct) < 0.0 else f": {word or _NOT_CHECKED}"
            predicted = "predicted sigma unknown" if text == MISSING else f"predicted {text} sigma{word}"
            lines.append(f"{start} {evidence_text(answer)} on {answer.where}{reason}; {predicted}")
    return lines


# --- The parts that both screens have.

START_SOURCE: Final = "start_source"  # The code of the note on what the start comes from.
MOST_ANSWERS: Final = 2  # More candidates have a row of a table each.
MOST_COLUMNS: Final = 3  # More candidates have no common table of evidence.
MOST_ROWS: Final = {1: 6, 2: 3, 3: 3}  # Evidence rows on a screen, by the number of candidates.
FOLDED: Final = 6  # Letters of a reason that are folded before a column is left out.


def _answer_parts(answers: Sequence[AnyCandidate]) -> Iterator[Part]:
    """Yield word, evidence, what would decide, and prediction of each candidate."""
    if len(answers) > MOST_ANSWERS:
        yield from (Sentences(()), _answer_table(answers))
        return
    lines: list[str | Callout] = []
    for answer in answers:
        start = f"{answer.filter} against {answer.baseline}: {shouted(answer.verdict)}"
        tone = TONES.get(answer.verdict, "")
        if answer.verdict == Verdict.NOT_EVALUATED:
            lines += [Callout(start, tone), f"{answer.reason[:1].upper()}{answer.reason[1:]}. Settle this first."]
            continue
        lines.append(Callout(f"{start}, {evidence_text(answer)}", tone))
        if found := would_decide(answer):
            lines.append(f"{found[:1].upper()}{found[1:]}.")
        lines.append(answer.predicted)
    if lines:
        yield Sentences(tuple(lines))


def _answer_table(answers: Sequence[AnyCandidate]) -> DisplayTable:
    """Return many candidates, a row each."""
    rows = []
    for answer in answers:
        predicted = (MISSING, "") if answer.verdict == Verdict.NOT_EVALUATED else predicted_change(answer)
        rows.append((answer.filter, shouted(answer.verdict), *evidence_cells(answer), *predicted, would_decide(answer)))
    baselines = " or ".join(dict.fromkeys(answer.baseline for answer in answers))
    header = ("filter", f"against {baselines}", "evidence", "ratio", "interval", "predicted sigma", "", "")
    return DisplayTable("", header, "lllrrrll", tuple(rows), spare=(7, 4, 5, 6, (2, 3)))


def _evidence_table(
    answers: Sequence[AnyCandidate], title: str, interval: str, starts: int = 0
) -> Iterator[DisplayTable]:
    """Yield the evidence: of one candidate with intervals and reasons, of several side by side."""
    evaluated = [answer for answer in answers if answer.verdict != Verdict.NOT_EVALUATED]
    if not evaluated or len(answers) > MOST_COLUMNS:
        return
    rows = chosen_rows([row for answer in evaluated for row in answer.known], MOST_ROWS[len(answers)])
    if not rows:
        return
    footnote = over_starts(starts)
    if len(answers) > 1:
        spoken = [row.quantity for answer in evaluated for row in spoken_rows(answer)]
        quantities = list(dict.fromkeys([*spoken, *(row.quantity for row in rows)]))
        yield _side_by_side(evaluated, quantities[: max(MOST_ROWS[len(answers)], len(set(spoken)))], title, footnote)
        return
    [answer] = answers
    is_pooled = isinstance(rows[0], PooledRow)
    columns: tuple[ShownColumn, ...] = (
        (title, "l", "quantity:label"),
        ("", "l", "unit"),
        (answer.baseline, "r", "baseline:value"),
        (answer.filter, "r", "value:value"),
        ("ratio", "r", lambda row: ratio_text(row.ratio)),
        (interval, "r", interval_text),
        ("won", "r", lambda row: f"{row.dives_won}/{row.dives}") if is_pooled else ("n", "r", "effective_samples:0"),
        ("p", "r", "p:significant" if is_pooled else _p_text),
        ("", "l", verdict_with_reason),
    )
    folds = FOLDED * any(reason_in_words(row) for row in rows)
    yield table_of("", rows, columns, footnote, spare=(7, 6, (1, 2, 3), 5), folds=folds)


def _p_text(row: Piece) -> str:
    """Write the p of a row on one dive; that of a row without a vote decides nothing."""
    return decimal(row.p, 3).removeprefix("0") if may_decide(row) else ""


def _side_by_side(
    answers: Sequence[AnyCandidate], quantities: Sequence[str], title: str, footnote: str
) -> DisplayTable:
    """Return ratio and verdict of several candidates in the same quantities, with the values where there is room."""
    found = {(answer.filter, row.quantity): row for answer in answers for row in answer.known}
    cells = []
    for quantity in quantities:
        rows = [found.get((answer.filter, quantity)) for answer in answers]
        known = next(row for row in rows if row is not None)
        texts = [label(quantity), known.unit, significant(known.baseline, 3)]
        for row in rows:
            texts += [significant(row.value, 3), ratio_text(row.ratio), verdict_in_table(row)] if row else [MISSING] * 3
        cells.append(tuple(texts))
    heads = (head for answer in answers for head in ("value", answer.filter, ""))
    header = (f"{title}: ratio", "", answers[0].baseline, *heads)
    values = (1, 2, *range(3, len(header), 3))
    return DisplayTable("", header, f"llr{'rrl' * len(answers)}", tuple(cells), footnote, spare=(values,))


# --- One dive: with one candidate at most 24 lines of 80 columns.


def dive_screen(report: Report, page: str) -> list[Part]:
    """Return the screen of one dive, whose page is at ``page``."""
    answers = [answer_on_dive(report, name) for name in report.filters]
    starts = max((row.starts for row in report.tables.evidence if row.evidence == "accuracy"), default=0)
    notes = f", {counted(len(report.notes), 'note')}" if report.notes else ""
    return [
        Title(_facts(report)),
        *_answer_parts(answers),
        *([] if report.filters else [line_alone(report)]),
        *_evidence_table(answers, "evidence", "on this dive", starts),
        *_trust_lines(report),
        *(note.text for note in report.notes if note.code == START_SOURCE),
        *headline_table(report),
        *track_fit_line(report),
        *(() if has_reference(report) else (NO_REFERENCE,)),
        Code(f"all tables{notes}: -v   page: {page}", ""),
    ]


def _trust_lines(report: Report) -> list[str]:
    """Say of each candidate whether it is consistent, and how large its innovations are if it is the only one."""
    if len(report.filters) > MOST_ANSWERS:
        return []
    lines, is_far_off = [], is_noise_far_off(report.tables, report.baseline)
    for name in (name for name, found in report.filters.items() if found.verdict != Verdict.NOT_EVALUATED):
        sizes = " Try --control, which fits the noise." if is_far_off else ""
        nis = next((row for row in of_filter(name, report.tables.evidence) if row.quantity == "nis"), None)
        if nis is not None and len(report.filters) == 1:
            values = f"{report.baseline} {significant(nis.baseline, 3)}, {name} {significant(nis.value, 3)}"
            sizes = f" {label(nis.quantity)}: {values}{', expected 1.' if is_far_off else '.'}{sizes}"
        lines.append(f"{trust_sentence(report.tables, name, report.baseline)}{sizes}")
    return list(dict.fromkeys(lines))


def _facts(report: Report) -> str:
    """Return a line with what was replayed."""
    tables, duration_s = report.tables, report.log.duration_s
    starts = max((row.starts for row in tables.evidence), default=0)
    # The first filter that takes velocities, or beams where none does.
    rows = [row for row in tables.consistency if row.measurement == "velocity"][:1]
    kind = "velocities" if rows else "beams"
    if not rows:
        beams = [row for row in tables.consistency if is_beam(row.measurement)]
        rows = [row for row in beams if row.filter == beams[0].filter]
    rejected = sum(row.rejected for row in rows)
    met = f"{sum(row.used for row in rows) + rejected} {kind}, {rejected} rejected" if rows else "no velocities"
    # An onboard solution may cover only a part of the dive. The baseline is compared over all of it.
    baseline = [row.samples for row in of_filter(report.baseline, tables.drift)]
    compared = max([row.samples for row in tables.reference_error] + baseline, default=0)
    known = has_reference(report)
    reference = f"reference {compared / duration_s:.2g} Hz" if known else "no reference"
    drawn = [counted(starts, "start")] if starts and known else []
    return f"{report.log.name}: {', '.join([f'{duration_s:.0f} s', met, reference, *drawn])}"


# --- Several dives: the pooled evidence, then a row for each dive.

MOST_DIVES: Final = 20  # With more dives, only the failed and the worst have rows.
MOST_FAILED, WORST, MOST_CODES = 8, 3, 3
FAILED: Final = GateStatus.FAILED  # Printed instead of a verdict.


def dives_screen(outcomes: Sequence[Outcome], index: str) -> list[Part]:
    """Return the screen of several dives, in the order of the logs, whose page is at ``index``."""
    reports = reports_of(outcomes)
    answers = answers_of(reports)
    pooled = [answer for answer in answers if answer.known and answer.log == EVERY_DIVE]
    said = [f"{answer.filter} {verdict_counts(answer.filter, reports, answer.verdict)}" for answer in answers]
    return [
        Title(_facts_of_dives(outcomes)),
        *_answer_parts(answers),
        *(part for table in _evidence_table(pooled, "all dives", "over dives") for part in (Sentences(()), table)),
        Sentences(()),
        _dives_table(outcomes, {answer.filter: answer for answer in pooled}) if answers else table_alone(outcomes),
        *([f"dive by dive, by all evidence: {'; '.join(said)}"] if said else []),
        *_consistency_counts(reports),
        Code(f"all tables: -v   page: {index}", ""),
    ]


def _facts_of_dives(outcomes: Sequence[Outcome]) -> str:
    """Return a line with the number of dives, of those that failed, and of those with warnings."""
    reports = reports_of(outcomes)
    said = [counted(len(outcomes), "dive"), f"{len(outcomes) - len(reports)} failed"]
    codes = [{note.code for note in report.notes if note.severity == Severity.WARNING} for report in reports]
    if counts := Counter(code for found in codes for code in found):
        named = [f"{code} {count}" for code, count in counts.most_common(MOST_CODES)]
        named += [f"{len(counts) - MOST_CODES} more"] if len(counts) > MOST_CODES else []
        said.append(f"warnings on {sum(map(bool, codes))}: {', '.join(named)}")
    return ", ".join(said)


def _consistency_counts(reports: Sequence[Report]) -> Iterator[str]:
    """Yield a line with the number of dives with each consistency of the innovations, for each filter."""
    texts = []
    for name in dict.fromkeys(name for report in reports for name in (report.baseline, *report.filters)):
        tables = [report.tables.consistency for report in reports if name in (report.baseline, *report.filters)]
        words = Counter(consistency_of(table, name) for table in tables)
        texts.append(f"{name} {', '.join(f'{count} {word}' for word, count in words.most_common())}")
    far_off = sum(is_noise_far_off(report.tables, report.baseline) for report in reports)
    advice = f". The noise settings are far off on {counted(far_off, 'dive')}: try --control" if far_off else ""
    if texts:
        yield f"consistency (NIS): {'; '.join(texts)}{advice}"


def _dives_table(outcomes: Sequence[Outcome], answers: Mapping[str, AnyCandidate]) -> DisplayTable:
    """Return a row for each dive: of each candidate the ratio and verdict in the quantity that decided over dives."""
    reports, names, footnotes = reports_of(outcomes), candidate_names(reports_of(outcomes)), list[str]()
    quantities, found = dict[str, str](), dict[tuple[str, str], EvidenceRow]()
    for name in names:
        rows = [(report.log.name, row) for report in reports for row in of_filter(name, report.tables.evidence)]
        # The quantity that decided over the dives, or could have; else the first evidence of a dive.
        spoken = spoken_rows(answers[name]) if name in answers else []
        others = (row for _, row in rows if row.evidence != CONSISTENCY)
        quantities[name] = next((row.quantity for row in (*spoken, *others)), "")
        found |= {(dive, name): row for dive, row in rows if row.quantity == quantities[name]}
    dives = {outcome.log if isinstance(outcome, Failure) else outcome.log.name: outcome for outcome in outcomes}
    if len(dives) > MOST_DIVES:
        largest = {dive: max(finite(row.ratio) for (log, _), row in found.items() if log == dive) for dive, _ in found}
        worst = sorted(largest, key=lambda dive: -largest[dive])[:WORST]
        failed = [dive for dive, outcome in dives.items() if isinstance(outcome, Failure)][:MOST_FAILED]
        dives = {dive: outcome for dive, outcome in dives.items() if dive in (*failed, *worst)}
        left_out = len(outcomes) - len(dives)
        footnotes.append(f"failed dives and the {WORST} largest ratios; {left_out} more are on the page")
    footnotes.insert(
        0, over_starts(max((row.starts for row in found.values() if row.evidence == "accuracy"), default=0))
    )
    shown = {
        dive: [_dive_cells(dives[dive], name, found.get((dive, name))) for name in names]
        for dive in sorted(dives, key=natural_key)
    }
    if len(names) == 1:
        [(name, quantity)] = quantities.items()
        cells = tuple((dive, *own) for dive, (own,) in shown.items())
        unit = next((f" [{row.unit}]" for row in found.values()), "")
        footnotes.insert(1, "all dives: the median of the values" if name in answers else "")
        if any(row[3] != MISSING == row[4] for row in cells):
            footnotes.append(f"-: fewer than {FEWEST_SHOWN} effective samples")
        header = (label(quantity), f"{baseline_names(reports)}{unit}", f"{name}{unit}", "ratio", "on this dive", "", "")
        end, folds = len(header) if any(row[-1] for row in cells) else -1, FOLDED * any(": " in row[5] for row in cells)
        cells, footnote = tuple(row[:end] for row in cells), "; ".join(filter(None, footnotes))
        return DisplayTable("", header[:end], "lrrrrll"[:end], cells, footnote, spare=((1, 2), 4), folds=folds)
    is_same = len(set(quantities.values())) == 1
    heads = [head for name in names for head in (name if is_same else f"{name}\n{label(quantities[name])}", "")]
    first = label(quantities[names[0]]) if is_same else "dive by dive"
    verdicts = tuple(range(len(heads), 0, -2)) if len(names) > MOST_COLUMNS else ()
    cells = tuple((dive, *(text for own in rows for text in (own[2], own[4]))) for dive, rows in shown.items())
    alignment, footnote = f"l{'rl' * len(names)}", "; ".join(filter(None, footnotes))
    return DisplayTable("", (first, *heads), alignment, cells, footnote, spare=verdicts)


def _dive_cells(outcome: Outcome, name: str, row: EvidenceRow | None) -> tuple[str, ...]:
    """Write of a candidate on a dive both values, ratio, interval and verdict, and the dive's if it is another."""
    if isinstance(outcome, Failure) or name not in outcome.filters:
        return *[MISSING] * 4, FAILED if isinstance(outcome, Failure) else MISSING, ""
    answer = answer_on_dive(outcome, name)
    if answer.verdict == Verdict.NOT_EVALUATED:
        return *[MISSING] * 4, shouted(answer.verdict), ""
    is_other = answer.spoken and (row is None or answer.verdict != row.verdict)
    other = f"{shouted(answer.verdict)} by {evidence_text(answer)}" if is_other else ""
    if row is None:
        return *[MISSING] * 5, other
    values, interval = (significant(row.baseline, 3), significant(row.value, 3)), interval_text(row)
    own = row.verdict if interval == MISSING else verdict_with_reason(row)
    return *values, ratio_text(row.ratio), interval, own, other
