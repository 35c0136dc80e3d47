"""The words of an answer: its headline, and the lines below it. Each is written here and nowhere else."""

import math
from collections.abc import Iterable, Sequence
from typing import Final

from insdvl_replay.core.dive_record import StartHeading
from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import DRAWN_HEADING, FEWEST_DIVES, WITHOUT_VERDICT, label
from insdvl_replay.core.tables import Number, PooledRow, finite, share_text, two_digits
from insdvl_replay.core.words import HeadingSource, Prediction, Verdict
from insdvl_replay.evaluation.answers import (
    BAD,
    GOOD,
    NOTABLE_PCT,
    Answer,
    CandidateAnswer,
    Undecided,
    seen_controls,
)
from insdvl_replay.evaluation.interval import change_found, dives_needed

MANY_TIMES: Final = 3.0  # A larger ratio is written in times instead of percent.
THREE_DIGITS: Final = 9.995  # From here on a ratio has three digits instead of two decimals.
SOUGHT: Final = 0.9  # The ratio for which a number of dives is given.
# Scatter of the ratio over dives, before any is known, for a candidate that moves the error by its own size.
SCATTER_OF_ACTS: Final = 0.6
NOT_NAVIGATED: Final = "How well it navigates with the DVL was not measured: no position reference."
# The words with which the sentence on a prediction begins; pages stress them.
CONFIRMED: Final = "Confirmed"
NOT_CONFIRMED: Final = "Not confirmed"
_HEADINGS: Final = {
    HeadingSource.REFERENCE: "heading of the reference",
    HeadingSource.SENSOR: "heading of the sensor",
    HeadingSource.FIT: "heading fitted to positions of the reference",
    HeadingSource.SETTINGS: "heading of the settings",
}


def shouted(verdict: str) -> str:
    """Write the word of a verdict in capitals."""
    return verdict.upper()


def word_of(answer: Answer) -> str:
    """Return the verdict in capitals; one dive has none."""
    if answer.undecided == Undecided.ONE_DIVE:
        return "one dive"
    return shouted(answer.verdict)


# --- A row.


def ratio_text(value: Number) -> str:
    """Write a ratio with two decimals, a large one with three digits; a dash where it is unknown."""
    if value is None or math.isnan(value):
        return "-"
    if abs(value) < THREE_DIGITS:
        return f"{value:.2f}"
    return f"{value:.3g}"


def interval_text(row: PooledRow) -> str:
    """Write the interval of a row, a dash where it has none."""
    low = finite(row.low)
    high = row.high
    if math.isnan(low) or high is None:
        return "-"
    return f"{ratio_text(low)} .. {ratio_text(high)}"


def ratio_with_interval(row: PooledRow) -> str:
    """Write ratio and interval, such as ``position 1.13 (0.95 .. 1.33)``."""
    return f"{label(row.quantity)} {_ratio_and_interval(row)}"


def _ratio_and_interval(row: PooledRow) -> str:
    interval = interval_text(row)
    if interval == "-":
        return ratio_text(row.ratio)
    return f"{ratio_text(row.ratio)} ({interval})"


def changed(row: PooledRow) -> str:
    """Say how much smaller or larger, or sooner or later, a quantity is."""
    name = label(row.quantity)
    ratio = finite(row.ratio)
    is_time = row.evidence == "convergence"
    if not math.isfinite(ratio):
        return f"{name} unknown"
    if ratio >= MANY_TIMES:
        return f"{name} {ratio:.3g} times as {'late' if is_time else 'large'}"
    smaller, larger = ("sooner", "later") if is_time else ("smaller", "larger")
    return f"{name} {abs(100.0 * (ratio - 1.0)):.1f} % {smaller if ratio <= 1.0 else larger}"


# --- The headline.


def headline(answer: Answer) -> str:
    """Return the verdict with the one ratio that made it, or the statement on one dive."""
    word = shouted(answer.verdict)
    said = grounds(answer)
    if not said:
        return word
    if _is_measured(answer) and answer.undecided == Undecided.ONE_DIVE:
        return said
    return f"{word}, {said}"


def grounds(answer: Answer) -> str:
    """Return the one ratio that made the verdict, or the statement on one dive; empty without a verdict."""
    primary = answer.decisive
    if answer.verdict in WITHOUT_VERDICT:
        return ""
    if answer.verdict == Verdict.NO_EFFECT:
        return _acting(answer)
    if primary is None or not _is_measured(answer):
        if answer.reason:
            return f"no evidence: {answer.reason}"
        return "no evidence"
    if answer.undecided == Undecided.ONE_DIVE:
        return f"on this dive {changed(primary)}; {answer.undecided}"
    pieces = [ratio_with_interval(primary)]
    if answer.dives > 1:
        better = "sooner" if primary.evidence == "convergence" else "smaller"
        pieces.append(f"{better} on {primary.dives_won} of {counted(primary.dives, 'dive')}")
    drawn = answer.from_drawn_heading
    if answer.is_by_heading and drawn is not None:
        pieces[0] += " from the heading of the reference"
        pieces.append(f"but {ratio_with_interval(drawn)}")
    pieces += [_warning(answer, row) for row in answer.warnings]
    return ", ".join(pieces)


def _is_measured(answer: Answer) -> bool:
    """Return whether the primary quantity has a ratio."""
    return answer.decisive is not None and math.isfinite(finite(answer.decisive.ratio))


def _warning(answer: Answer, row: PooledRow) -> str:
    joined = "but " if answer.verdict in (*GOOD, *BAD) else ""
    name = "without the DVL" if row.evidence == "outage" else label(row.quantity)
    return f"{joined}{name} {_ratio_and_interval(row)} {row.verdict}"


# --- The lines below.


def acts_line(answer: Answer) -> str:
    """Say how far the candidate moves the track, or another error; empty where it is not known."""
    if answer.acting is not None:
        return f"acts: {_acting(answer)}"
    return ""


def _acting(answer: Answer) -> str:
    """Say how far the candidate moves the primary quantity, and the quantity that it moves most."""
    primary = answer.decisive
    largest = answer.acting
    if largest is None:
        return "how far it moves the errors is not known"
    if finite(largest.acts) == 0.0:
        return "identical: it was never updated, its weight vanishes in the noise, or a setting was not read"
    position = next((row for row in answer.rows if row.quantity == "position"), primary)
    shown = position if position is not None and math.isfinite(finite(position.acts)) else largest
    what = _named(shown)
    moved = f"moves {what} by {_moves(shown)}, {share_text(shown.acts)} of its error"
    if largest.quantity == shown.quantity:
        return moved
    if answer.verdict == Verdict.NO_EFFECT:
        return f"{moved}; no error by more than {share_text(largest.acts_most)}"
    return f"{moved}; {_named(largest)} by {share_text(largest.acts)}"


def _named(row: PooledRow) -> str:
    """Name the error of a row, for a sentence."""
    if row.quantity == "position":
        return "the track"
    if row.quantity == DRAWN_HEADING:
        return "the track from a drawn heading"
    if row.evidence == "outage":
        return f"the drift in a {label(row.quantity)}"
    return f"the {label(row.quantity)}"


def _moves(row: PooledRow) -> str:
    value = finite(row.moves)
    if row.unit == "m" and value < 1.0:
        return f"{two_digits(1000.0 * value)} mm"
    return f"{two_digits(value)} {row.unit}"


def start_of(headings: Iterable[StartHeading]) -> str:
    """Say what the heading at the start of some dives comes from and how well it is known, by source."""
    by_source: dict[HeadingSource, list[float]] = {}
    for heading in headings:
        by_source.setdefault(heading.source, []).append(heading.sd_deg)
    texts = []
    for source, sds_deg in by_source.items():
        least = f"{min(sds_deg):.2g}"
        most = f"{max(sds_deg):.2g}"
        size = least if least == most else f"{least} to {most}"
        dives = f" on {counted(len(sds_deg), 'dive')}" if len(by_source) > 1 else ""
        texts.append(f"{_HEADINGS[source]} ({size} deg){dives}")
    return ", ".join(texts)


def start_line(answer: Answer, start: str = "") -> str:
    """Name the start, with the position from a heading that was drawn instead; empty where neither is known."""
    row = answer.from_drawn_heading
    if row is None or not math.isfinite(finite(row.ratio)):
        if start:
            return f"start: {start}"
        return ""
    found = (
        changed(row)
        if answer.evaluated < FEWEST_DIVES
        else f"{ratio_with_interval(row)} {row.verdict}"
    )
    return f"start: {start or 'heading of the reference'}; from a heading as uncertain as [initial]: {found}"


def settling_line(answer: Answer, initial: str = "") -> str:
    """Return the second answer, from starts as uncertain as ``initial`` says; empty where it is not known."""
    row = answer.settles
    if row is None:
        return ""
    start = (
        f", from starts as uncertain as [initial]: {initial}" if initial else ", from drawn starts"
    )
    if not math.isfinite(finite(row.ratio)):
        return f"convergence: {label(row.quantity)} not comparable, since a filter never settles{start}"
    if answer.evaluated < FEWEST_DIVES:
        return f"convergence: {changed(row)}, from drawn starts"
    return f"convergence: {shouted(row.verdict)}, {ratio_with_interval(row)}{start}"


def predicted_line(answer: CandidateAnswer) -> str:
    """State the predicted change of sigma, and whether the primary quantity confirms it."""
    pct = finite(answer.predicted_pct)
    if math.isnan(pct):
        return "predicted: unknown, since it reports the sigma of only some states, or of none."
    said = f"predicted: {abs(pct):.1f} % {'smaller' if pct >= 0.0 else 'larger'} sigma"
    if answer.evaluated > 1:
        said += f", median of {counted(answer.evaluated, 'dive')}"
    if pct < NOTABLE_PCT:
        return f"{said}."
    return f"{said}. {_confirmed(answer)}."


def _confirmed(answer: CandidateAnswer) -> str:
    primary = answer.decisive
    if primary is None or not math.isfinite(finite(primary.ratio)):
        return f"{NOT_CONFIRMED}: no error was measured"
    name = label(primary.quantity)
    if answer.prediction == Prediction.CONFIRMED:
        return f"{CONFIRMED}: {changed(primary)}"
    if finite(primary.ratio) >= 1.0 or answer.verdict == Verdict.NO_EFFECT:
        return f"{NOT_CONFIRMED}: {name} is not smaller"
    if answer.prediction == Prediction.NOT_CONFIRMED:
        return f"{NOT_CONFIRMED}: {name} is smaller by less than half of it"
    if answer.evaluated < FEWEST_DIVES:
        return f"{NOT_CONFIRMED}: it takes {FEWEST_DIVES} dives"
    return f"{NOT_CONFIRMED}: the interval of {name} is too wide to tell"


def plan_line(answer: Answer) -> str:
    """Say what change these dives find in the primary quantity, and how many find 10 %; empty where it is not known."""
    primary = answer.decisive
    if primary is None or answer.verdict in (Verdict.NO_EFFECT, *WITHOUT_VERDICT):
        return ""
    level = finite(primary.level_pct) / 100.0
    name = label(primary.quantity)
    if primary.dives < FEWEST_DIVES:
        if not answer.undecided:  # it is proved
            return ""
        scatter = SCATTER_OF_ACTS * finite(primary.acts)
        needed = dives_needed(scatter, SOUGHT, level) if math.isfinite(scatter) else None
        about = f"; about {needed} dives like {'this one' if primary.dives == 1 else 'these'} find a change of 10 %"
        return f"A verdict takes {FEWEST_DIVES} dives{about if needed else ''}."
    found = change_found(finite(primary.scatter), primary.dives, level)
    if not math.isfinite(found):
        return ""
    needed = dives_needed(finite(primary.scatter), SOUGHT, level)
    more = f"; {needed} dives: 10 %" if needed is not None and needed > primary.dives else ""
    return f"These dives find a change of {100.0 * (1.0 - found):.0f} % in {name} in four of five cases{more}."


def assay_line(rows: Sequence[PooledRow]) -> str:
    """Say which planted faults the primary quantity would have seen; empty without an assay."""
    seen, missed = seen_controls(rows)
    if not (seen or missed):
        return ""
    if not seen:
        return f"assay: not sensitive, no control was seen: {', '.join(missed)}"
    unseen = f"; not seen: {', '.join(missed)}" if missed else ""
    return f"assay: seen: {', '.join(seen)}{unseen}"


def answer_lines(answer: CandidateAnswer, initial: str = "", start: str = "") -> list[str]:
    """Return the lines below the headline; the start is named where it is given, or where the answer depends on it."""
    if answer.verdict in WITHOUT_VERDICT:
        return [f"{begun_with_capital(answer.reason, answer)}. Settle this first."]
    is_outage = answer.decisive is not None and answer.decisive.evidence == "outage"
    lines = [
        NOT_NAVIGATED if is_outage else "",
        "" if answer.verdict == Verdict.NO_EFFECT else acts_line(answer),
        start_line(answer, start),
        settling_line(answer, initial),
        predicted_line(answer),
        plan_line(answer),
    ]
    return [line for line in lines if line]


def begun_with_capital(text: str, answer: Answer) -> str:
    """Begin a sentence with a capital letter; a name keeps its first letter."""
    is_name = text.startswith((answer.filter, answer.baseline))
    if is_name:
        return text
    return f"{text[:1].upper()}{text[1:]}"


def paragraph(answer: CandidateAnswer, start: str = "") -> str:
    """Return the answer as one paragraph, which names the start where it is given."""
    lines = [
        f"{answer.filter} against {answer.baseline}: {headline(answer)}",
        *answer_lines(answer, start=start),
    ]
    return " ".join(line if line.endswith(".") else f"{line}." for line in lines)
