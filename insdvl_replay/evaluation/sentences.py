"""The words of an answer: its headline, and the lines below it. Each is written here and nowhere else."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from insdvl_replay.core.dive_record import StartHeading
from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import DRAWN_HEADING, FEWEST_DIVES, WITHOUT_VERDICT, label
from insdvl_replay.core.tables import (
    Number,
    PooledRow,
    WhereRow,
    finite,
    share_text,
    two_digits,
)
from insdvl_replay.core.words import HeadingSource, Prediction, Reason, ReasonCode, Verdict
from insdvl_replay.evaluation.answers import (
    BAD,
    GOOD,
    NOTABLE_PCT,
    Answer,
    CandidateAnswer,
    largest_acts,
    seen_controls,
)
from insdvl_replay.evaluation.interval import (
    change_found,
    dives_needed,
    word_of_interval,
)

MANY_TIMES: Final = 3.0  # A larger ratio is written in times instead of percent.
THREE_DIGITS: Final = 9.995  # From here on a ratio has three digits instead of two decimals.
SOUGHT: Final = 0.9  # The ratio for which a number of dives is given.
_SOUGHT_SIZE: Final = f"{100.0 * (1.0 - SOUGHT):.0f} %"
# Scatter of the ratio over dives, before any is known, for a candidate that moves the error by its own size.
SCATTER_OF_ACTS: Final = 0.6
NOT_NAVIGATED: Final = (
    "How well it navigates with the DVL was not measured: no position reference."
)
# The words with which the sentence on a prediction begins; pages stress them.
CONFIRMED: Final = "Confirmed"
NOT_CONFIRMED: Final = "Not confirmed"
_HEADINGS: Final = {
    HeadingSource.REFERENCE: "heading of the reference",
    HeadingSource.SENSOR: "heading of the sensor",
    HeadingSource.FIT: "heading fitted to positions of the reference",
    HeadingSource.SETTINGS: "heading of the settings",
}


# Why there is no word.
_UNDECIDED: Final = {
    ReasonCode.ONE_DIVE: "one dive cannot tell whether the next one will be",
    ReasonCode.FEW_DIVES: "fewer than three dives",
    ReasonCode.NO_PRIMARY: "no quantity that may decide was measured",
    ReasonCode.NOISE: "most of the error is noise of the reference",
    ReasonCode.WIDE: "the interval reaches into the band",
}
# Why a verdict on a filter's consistency differs from its interval.
_IN_SPITE: Final[Mapping[str, str]] = {
    Reason.NEAR: "within 10 % of the expected value",
    Reason.EXACT_START: "errors are small at first, since the filter starts on the reference",
    Reason.ONE_SAMPLE: "a lasting error counts as one sample",
    Reason.BEYOND_3_SD: "too many errors beyond 3 sd",
}


def why_undecided(answer: Answer) -> str:
    """Say why an answer has no word; empty where it has one."""
    return _UNDECIDED.get(answer.undecided, "")


def why_in_spite(reason: str) -> str:
    """Say why a verdict on a filter's consistency differs from its interval; early results have the sentence itself."""
    return _IN_SPITE.get(reason, reason)


def shouted(verdict: str) -> str:
    """Write the word of a verdict in capitals."""
    return verdict.upper()


def word_of(answer: Answer) -> str:
    """Return the verdict in capitals; one dive has none."""
    if answer.undecided == ReasonCode.ONE_DIVE:
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


def interval_text(row: PooledRow | WhereRow) -> str:
    """Write the interval of a row, a dash where it has none."""
    return interval_of(row.low, row.high)


def interval_of(low: Number, high: Number) -> str:
    """Write an interval, a dash where there is none."""
    if math.isnan(finite(low)) or high is None:
        return "-"
    return f"{ratio_text(low)} .. {ratio_text(high)}"


def ratio_with_interval(row: PooledRow) -> str:
    """Write ratio and interval, such as ``position 1.13 (0.95 .. 1.33)``."""
    return f"{label(row.quantity)} {_ratio_and_interval(row)}"


def _ratio_and_interval(row: PooledRow | WhereRow) -> str:
    interval = interval_text(row)
    if interval == "-":
        return ratio_text(row.ratio)
    return f"{ratio_text(row.ratio)} ({interval})"


class _Words(NamedTuple):
    """The words in which numbers are compared."""

    smaller: str
    larger: str
    large: str


_OF_SIZES: Final = _Words("smaller", "larger", "large")
_OF_TIMES: Final = _Words("sooner", "later", "late")


def changed(row: PooledRow) -> str:
    """Say how much smaller or larger, or sooner or later, a quantity is."""
    name = label(row.quantity)
    ratio = finite(row.ratio)
    words = _OF_TIMES if row.evidence == "convergence" else _OF_SIZES
    if not math.isfinite(ratio):
        return f"{name} unknown"
    if ratio >= MANY_TIMES:
        return f"{name} {ratio:.3g} times as {words.large}"
    percent = f"{abs(100.0 * (ratio - 1.0)):.1f} %"
    if ratio <= 1.0:
        return f"{name} {percent} {words.smaller}"
    return f"{name} {percent} {words.larger}"


# --- The headline.


def headline(answer: Answer) -> str:
    """Return the verdict with the one ratio that made it, or the statement on one dive."""
    word = shouted(answer.verdict)
    said = grounds(answer)
    if not said:
        return word
    if _is_measured(answer) and answer.undecided == ReasonCode.ONE_DIVE:
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
    if answer.undecided == ReasonCode.ONE_DIVE:
        return f"on this dive {changed(primary)}; {why_undecided(answer)}"
    return ", ".join(_for_and_against(answer, primary))


def _for_and_against(answer: Answer, primary: PooledRow) -> list[str]:
    """Return the ratio that made the verdict, and what speaks for and against it."""
    pieces = [ratio_with_interval(primary)]
    if answer.dives > 1:
        better = "sooner" if primary.evidence == "convergence" else "smaller"
        pieces.append(f"{better} on {primary.dives_won} of {_dives_of_vehicles(primary)}")
    drawn = answer.from_drawn_heading
    if answer.is_by_heading and drawn is not None:
        pieces[0] += " from the heading of the reference"
        pieces.append(f"but {ratio_with_interval(drawn)}")
    for row in answer.warnings:
        warning = _warning(row)
        if answer.verdict in (*GOOD, *BAD):
            warning = f"but {warning}"
        pieces.append(warning)
    return pieces


def _dives_of_vehicles(row: PooledRow) -> str:
    """Count the dives of a row, and their vehicles where somebody said which they were."""
    dives = counted(row.dives, "dive")
    if row.vehicles:
        return f"{dives} of {counted(row.vehicles, 'vehicle')}"
    return dives


def _is_measured(answer: Answer) -> bool:
    """Return whether the primary quantity has a ratio."""
    return answer.decisive is not None and math.isfinite(finite(answer.decisive.ratio))


def _warning(row: PooledRow) -> str:
    name = "without the DVL" if row.evidence == "outage" else label(row.quantity)
    return f"{name} {_ratio_and_interval(row)} {row.verdict}"


# --- The lines below.


def acts_line(answer: Answer) -> str:
    """Say how far the candidate moves the track, or another error; empty where it is not known."""
    if answer.acting is not None:
        return f"acts: {_acting(answer)}"
    return ""


def _acting(answer: Answer) -> str:
    """Say how far the candidate moves the primary quantity, and the quantity that it moves most."""
    largest = answer.acting
    if largest is None:
        return "how far it moves the errors is not known"
    if finite(largest.acts) == 0.0:
        return _hardly_acting(answer)
    shown = _position_or_primary(answer)
    if shown is None or not math.isfinite(finite(shown.acts)):
        shown = largest
    moved = f"moves {_named(shown)} by {_moves(shown)}, {share_text(shown.acts)} of its error"
    if largest.quantity == shown.quantity:
        return moved
    if answer.verdict == Verdict.NO_EFFECT:
        return f"{moved}; no error by more than {share_text(largest.acts_most)}"
    return f"{moved}; {_named(largest)} by {share_text(largest.acts)}"


def _hardly_acting(answer: Answer) -> str:
    """Say that a candidate is identical on all dives, or on most of them, and how far it moves an error on others."""
    if largest_acts(answer.rows) == 0.0:
        return "identical: it was never updated, its weight vanishes in the noise, or a setting was not read"
    said = "identical on most dives"
    known = [row for row in answer.rows if finite(row.acts_most) > 0.0]
    most = max(known, key=lambda row: finite(row.acts_most), default=None)
    if most is None:
        return said
    return f"{said}; moves {_named(most)} by up to {share_text(most.acts_most)} of its error"


def _position_or_primary(answer: Answer) -> PooledRow | None:
    """Return the row of the position, else the primary row; None if there is neither."""
    for row in answer.rows:
        if row.quantity == "position":
            return row
    return answer.decisive


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
        size = f"{min(sds_deg):.2g}"
        most = f"{max(sds_deg):.2g}"
        if most != size:
            size = f"{size} to {most}"
        text = f"{_HEADINGS[source]} ({size} deg)"
        if len(by_source) > 1:
            text = f"{text} on {counted(len(sds_deg), 'dive')}"
        texts.append(text)
    return ", ".join(texts)


def start_line(answer: Answer, start: str = "") -> str:
    """Name the start, with the position from a heading that was drawn instead; empty where neither is known."""
    row = answer.from_drawn_heading
    if row is None or not math.isfinite(finite(row.ratio)):
        if start:
            return f"start: {start}"
        return ""
    found = f"{ratio_with_interval(row)} {row.verdict}"
    if answer.evaluated < FEWEST_DIVES:
        found = changed(row)
    own = start or "heading of the reference"
    return f"start: {own}; from a heading as uncertain as [initial]: {found}"


def settling_line(answer: Answer, initial: str = "") -> str:
    """Return the second answer, from starts as uncertain as ``initial`` says; empty where it is not known."""
    row = answer.settles
    if row is None:
        return ""
    starts = "from drawn starts"
    if initial:
        starts = f"from starts as uncertain as [initial]: {initial}"
    if not math.isfinite(finite(row.ratio)):
        name = label(row.quantity)
        return f"convergence: {name} not comparable, since a filter never settles, {starts}"
    if answer.evaluated < FEWEST_DIVES:
        return f"convergence: {changed(row)}, from drawn starts"
    found = ratio_with_interval(row)
    if row.dives < answer.evaluated:
        found += f" on {row.dives} of {counted(answer.evaluated, 'dive')}"
    return f"convergence: {shouted(row.verdict)}, {found}, {starts}"


def predicted_line(answer: CandidateAnswer) -> str:
    """State the predicted change of sigma, and whether the primary quantity confirms it."""
    pct = finite(answer.predicted_pct)
    if math.isnan(pct):
        return "predicted: unknown, since it reports the sigma of only some states, or of none."
    word = "smaller" if pct >= 0.0 else "larger"
    said = f"predicted: {abs(pct):.1f} % {word} sigma"
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
        return f"{CONFIRMED}: {_shown_change(primary)}"
    if finite(primary.ratio) >= 1.0 or answer.verdict == Verdict.NO_EFFECT:
        return f"{NOT_CONFIRMED}: {name} is not smaller"
    if answer.prediction == Prediction.NOT_CONFIRMED:
        return f"{NOT_CONFIRMED}: {name} is smaller by less than half of it"
    if answer.evaluated < FEWEST_DIVES:
        return f"{NOT_CONFIRMED}: it takes {FEWEST_DIVES} dives"
    return f"{NOT_CONFIRMED}: the interval of {name} is too wide to tell"


def _shown_change(row: PooledRow) -> str:
    """Write the ratio of a row with its interval, a change in percent where there is no interval."""
    if interval_text(row) == "-":
        return changed(row)
    return ratio_with_interval(row)


def plan_line(answer: Answer) -> str:
    """Say what change these dives find in the primary quantity, and how many find 10 %; empty where it is not known."""
    primary = answer.decisive
    if primary is None or answer.verdict in (Verdict.NO_EFFECT, *WITHOUT_VERDICT):
        return ""
    if primary.dives < FEWEST_DIVES:
        is_proved = not answer.undecided
        if is_proved:
            return ""
        return _plan_for_first_verdict(primary)
    level = finite(primary.level_pct) / 100.0
    if math.isnan(finite(primary.scatter)) and math.isfinite(finite(primary.low)):
        return "Each vehicle is one sample: more vehicles make the interval narrower, more dives do not."
    found = change_found(finite(primary.scatter), primary.dives, level)
    if not math.isfinite(found):
        return ""
    size = f"{100.0 * (1.0 - found):.0f} %"
    name = label(primary.quantity)
    said = f"These dives would show a change of {size} in {name} in four of five cases"
    needed = dives_needed(finite(primary.scatter), SOUGHT, level)
    if needed is None or needed <= primary.dives or size == _SOUGHT_SIZE:
        return f"{said}."
    return f"{said}, while {needed} dives would show one of {_SOUGHT_SIZE}."


def _plan_for_first_verdict(primary: PooledRow) -> str:
    """Say how many dives it takes, by a usual scatter of dives for a candidate that moves the errors so far."""
    said = f"A verdict takes {FEWEST_DIVES} dives"
    scatter = SCATTER_OF_ACTS * finite(primary.acts)
    if not math.isfinite(scatter):
        return f"{said}."
    needed = dives_needed(scatter, SOUGHT, finite(primary.level_pct) / 100.0)
    if needed is None:
        return f"{said}."
    return f"{said}; about {needed} such dives would show a change of {_SOUGHT_SIZE}."


def assay_line(rows: Sequence[PooledRow]) -> str:
    """Say which planted faults the primary quantity would have seen; empty without an assay."""
    seen, missed = seen_controls(rows)
    if not (seen or missed):
        return ""
    if not seen:
        return f"assay: not sensitive, no control was seen: {', '.join(missed)}"
    if not missed:
        return f"assay: seen: {', '.join(seen)}"
    return f"assay: seen: {', '.join(seen)}; not seen: {', '.join(missed)}"


def answer_lines(answer: CandidateAnswer, initial: str = "", start: str = "") -> list[str]:
    """Return the lines below the headline; the start is named where it is given, or where the answer depends on it."""
    if answer.verdict in WITHOUT_VERDICT:
        return [f"{begun_with_capital(answer.reason, answer)}. Settle this first."]
    lines = []
    if answer.decisive is not None and answer.decisive.evidence == "outage":
        lines.append(NOT_NAVIGATED)
    if answer.verdict != Verdict.NO_EFFECT:
        lines.append(acts_line(answer))
    lines += [
        start_line(answer, start),
        settling_line(answer, initial),
        predicted_line(answer),
        plan_line(answer),
    ]
    return [line for line in lines if line]


# --- Where it helped.

_WHERE: Final = {
    "straight": "on straight legs",
    "turns": "in turns",
    "hover": "while hovering",
    "climbs": "in climbs and descents",
    "no_bottom_lock": "without bottom lock",
    "near_bottom": "near the bottom",
    "fast": "when fast",
    "slow": "when slow",
}
# What makes a filter worse there, and not elsewhere.
_LOOK_AT: Final = {
    "straight": "heading, mounting and scale of the DVL",
    "turns": "lever arm and delay",
    "hover": "the noise of the DVL at rest and the gyro biases",
    "climbs": "mounting in pitch and the depth",
    "no_bottom_lock": "noise and biases of the IMU",
    "near_bottom": "the gate and lost beams",
    "fast": "scale and mounting of the DVL",
    "slow": "the noise of the DVL",
}


def where_line(rows: Sequence[WhereRow]) -> str:
    """Say where a candidate is better or worse than elsewhere, by the notable rows; empty without any."""
    if not rows:
        return ""
    first, *others = rows
    line = _where_text(first)
    if finite(first.ratio) > 1.0:
        line += f"; look at {_LOOK_AT[first.bin]}"
    if others:
        line += f". Also {', '.join(map(_where_text, others))}"
    return line


def _where_text(row: WhereRow) -> str:
    """Write the ratio of a bin, such as ``worse in turns: 1.31 (1.12 .. 1.53)``."""
    word = word_of_interval(finite(row.low), finite(row.high))
    return f"{word} {_WHERE[row.bin]}: {_ratio_and_interval(row)}"


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
