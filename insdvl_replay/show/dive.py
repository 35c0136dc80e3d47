"""What people see of one dive: its screen on a terminal, its tables in every format, its page."""

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import Any, Final, Protocol, TypeVar

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import require_known, visible
from insdvl_replay.core.quantities import (
    CONSISTENT,
    DECIDING,
    DECIDING_TOGETHER,
    HELD_OUT_QUANTITIES,
    is_whole,
    label,
)
from insdvl_replay.core.result import (
    PAGE,
    PRINTED,
    PRINTED_LONG,
    Block,
    Callout,
    Code,
    DisplayTable,
    Figure,
    Heading,
    Html,
    Only,
    Panel,
    Part,
    Report,
    Result,
    Sentences,
    Title,
    flattened,
)
from insdvl_replay.core.tables import TABLES, CandidateVerdict, EvidenceRow, Number, PooledRow, each_table, finite
from insdvl_replay.core.words import Consistency, EvidenceVerdict, Prediction, ReferenceStatus, Verdict
from insdvl_replay.evaluation.evidence import SOONER
from insdvl_replay.evaluation.series import FEWEST_EFFECTIVE, LARGEST_P, MARGIN
from insdvl_replay.evaluation.verdicts import (
    FEWEST_SHOWN,
    NOTABLE_PCT,
    P,
    Piece,
    on_prediction,
    shown_interval,
)
from insdvl_replay.show.document import (
    MISSING,
    TENFOLD,
    Column,
    counted,
    decimal,
    notes_table,
    number,
    percent,
    shown,
    significant,
    table_of,
)

NO_REFERENCE: Final = (
    "There is no reference, so true errors are unknown: accuracy, measured convergence, credibility and the predicted "
    "improvement cannot be checked."
)
SPECIFIED: Final = (
    "of distance: final horizontal error. CEP50, CEP95: 50 % and 95 % of the horizontal errors of this run are "
    "smaller. without DVL: median drift in the DVL outage test, measured by the held-out velocities."
)
"""The meaning of the columns of the headline."""
MEANS: Final = (
    "measured: how much smaller the error is, by the first row of the evidence; predicted: how much smaller sigma is, "
    "mean of nine states, by the filter's own covariance"
)
"""The meaning of the columns of candidates."""
TONES: Final[dict[str, str]] = {
    Verdict.BETTER: "good",
    Verdict.MIXED: "bad",
    Verdict.WORSE: "bad",
    Verdict.NOT_EVALUATED: "bad",
}
"""The colours of verdicts."""
LOUD: Final = (Verdict.BETTER, Verdict.WORSE, Verdict.MIXED, Verdict.NOT_EVALUATED)
"""Verdicts that are written in capitals."""
DECIDED: Final = (EvidenceVerdict.BETTER, EvidenceVerdict.WORSE)


class _FilterRow(Protocol):
    @property
    def filter(self) -> str: ...


Row = TypeVar("Row", bound=_FilterRow)


def of_filter(name: str, rows: Iterable[Row]) -> list[Row]:
    """Return the rows of a filter."""
    return [row for row in rows if row.filter == name]


def has_reference(report: Report) -> bool:
    """Return whether the dive has a reference; early reports lack one of the two tables that show it."""
    found = [row.verdict for row in report.tables.credibility] + [row.status for row in report.tables.reference_error]
    return any(word != ReferenceStatus.NO_REFERENCE for word in found)


def shouted(verdict: str) -> str:
    """Write an important verdict in capitals."""
    return verdict.upper() if verdict in LOUD else verdict


def ratio_text(value: Number) -> str:
    """Write a ratio with two decimals, a large one with three digits."""
    return decimal(value, 2) if abs(finite(value)) < TENFOLD else significant(value, 3)


def interval_text(row: Piece) -> str:
    """Write the interval of a row, where it is shown."""
    low, high = shown_interval(row)
    return MISSING if low is None or high is None else f"{ratio_text(low)} .. {ratio_text(high)}"


def verdict_in_table(row: Piece) -> str:
    """Return the verdict of an evidence row, in brackets if it has no vote."""
    deciding = DECIDING_TOGETHER if isinstance(row, PooledRow) else DECIDING
    return row.verdict if row.quantity in deciding or not row.verdict else f"({row.verdict})"


def reason_in_words(row: Piece) -> str:
    """Say why a row has no interval, or is neither better nor worse although its interval excludes 1; else empty."""
    if row.ratio is None or row.evidence == CONSISTENT or row.verdict in ("", *DECIDED):
        return ""
    is_pooled, is_time, (low, high) = isinstance(row, PooledRow), row.evidence == "convergence", shown_interval(row)
    if isinstance(row, EvidenceRow) and row.why:
        return row.why
    if row.evidence == "track" and not is_pooled:
        return "one dive is one sample"
    if low is None or high is None:
        return f"fewer than {FEWEST_SHOWN} {'dives' if is_pooled else 'effective samples'}"
    if low <= 1.0 <= high:
        return ""
    change = ("sooner" if is_time else "smaller") if row.ratio < 1.0 else "later" if is_time else "larger"
    for margin in (MARGIN, SOONER) if is_time and not is_pooled else (MARGIN,):
        if 1.0 / (1.0 + margin) < row.ratio < 1.0 + margin:
            return f"{change}, but less than {100.0 * margin:.0f} %"
    if not finite(row.p) < LARGEST_P:
        return f"{change}, but maybe less than {100.0 * MARGIN:.0f} %"
    return "never settled on some dive" if is_pooled else f"fewer than {FEWEST_EFFECTIVE:.0f} effective samples"


def as_shown(row: P) -> P:
    """Return an evidence row as tables show it: its interval if it is shown, verdict and reason in words."""
    low, high = shown_interval(row)
    why = {} if isinstance(row, PooledRow) else {"why": reason_in_words(row)}
    return replace(row, low=low, high=high, verdict=verdict_in_table(row), **why)


# --- Tables.


def headline_table(report: Report, title: str = "", footnote: str = "") -> Iterator[DisplayTable]:
    """Return the errors of this run as INS/DVL systems are specified, a row for each filter, where known."""
    position = {row.filter: row for row in report.tables.drift if row.quantity == "position_h"}
    outages = {(row.window_s, row.filter): row.drift_median_m for row in report.tables.outage if row.windows}
    tested = {window_s for window_s, _ in outages}
    windows_s = [window_s for window_s in ("60", "120") if window_s in tested] or sorted(tested)[:1]
    header = ["this run", *(("of distance", "CEP50", "CEP95", "end") if position else ())]
    header += [f"{window_s} s{'' if i else ' without DVL'}" for i, window_s in enumerate(windows_s)]

    def metres(value: Number) -> str:
        return MISSING if value is None else f"{value:.3g} m" if value < 1000.0 else f"{value:.0f} m"

    rows = []
    for name in (report.baseline, *report.filters):
        row, errors = position.get(name), [MISSING] * 4
        if row is not None:
            pct, distance_m = row.final_of_distance_pct, row.distance_m
            of_distance = MISSING if pct is None else f"{pct:.2f} % of {distance_m:.0f} m"
            errors = [of_distance, *map(metres, (row.p50, row.p95, row.final))]
        rows.append((name, *(errors if position else ()), *(metres(outages.get((at, name))) for at in windows_s)))
    if len(header) > 1:
        spare = tuple(range(len(header) - 1, 1, -1))
        yield DisplayTable(title, tuple(header), f"l{'r' * (len(header) - 1)}", tuple(rows), footnote, spare=spare)


def track_fit_line(report: Report) -> Iterator[str]:
    """Return a line with the scale and the turn that align the baseline's track with the reference's, if known."""
    texts = []
    for row in of_filter(report.baseline, report.tables.track_fit):
        # With two to four digits: to the first digit of the standard error at least.
        digits = next((n for n in range(2, 5) if finite(row.fitted_sd) >= 10.0**-n), 2)
        sd = "" if row.fitted_sd is None else f" \N{PLUS-MINUS SIGN} {row.fitted_sd:.{digits}f}"
        texts.append(f"{row.quantity} {finite(row.fitted):+.{digits}f}{sd} {row.unit}")
    if texts:
        yield f"track fit: {', '.join(texts)}"


def glance_table(report: Report) -> DisplayTable:
    """Return each candidate's verdicts, and its measured and predicted improvement."""
    known, rows = has_reference(report), []
    for name, candidate in report.filters.items():
        *gains, prediction = gain_cells(report, name)
        consistency_words = (prediction, candidate.consistency, candidate.credibility or MISSING)
        rows.append((name, *gains, *(consistency_words if known else consistency_words[1:2])))
    header = ("filter", "verdict", "measured", "predicted", *(("prediction",) if known else ()), "innovations")
    words = "innovations and errors" if known else "innovations"
    return DisplayTable(
        "At a glance",
        (*header, *(("errors",) if known else ())),
        "llrrlll"[: 7 if known else 5],
        tuple(rows),
        f"{MEANS}; {words}: consistency, whether they are as large as the filter's sigma",
    )


def gain_cells(report: Report, name: str) -> tuple[str, str, str, str]:
    """Write verdict, measured improvement, predicted improvement and prediction of a candidate."""
    candidate = report.filters[name]
    if candidate.verdict == Verdict.NOT_EVALUATED:
        return Verdict.NOT_EVALUATED, MISSING, MISSING, MISSING
    first = next((row for row in report.tables.evidence if row.filter == name and row.evidence != CONSISTENT), None)
    measured = MISSING if first is None or first.ratio is None else percent(100.0 * (1.0 - first.ratio))
    return candidate.verdict, measured, percent(candidate.mean_improvement_pct), candidate.prediction or MISSING


def tables_of(report: Report) -> dict[tuple[str, str], DisplayTable]:
    """Return the tables that have rows, as shown: by name, and by filter if each filter has its own."""
    found: dict[tuple[str, str], DisplayTable] = {}
    for layout, rows in each_table(report.tables):
        kept: list[Any] = list(filter(_SHOWN_ROWS.get(layout.name), rows))
        if layout.name == "evidence":
            kept = [as_shown(row) for row in kept]
        elif layout.name == "drift":
            quantities = list(dict.fromkeys(row.quantity for row in kept))
            kept.sort(key=lambda row: quantities.index(row.quantity))
        is_apart = "{filter}" in layout.title
        for name in (report.baseline, *report.filters) if is_apart else ("",):
            if own := of_filter(name, kept) if is_apart else kept:
                footnote = _footnote(report, layout.name, name, own)
                found[layout.name, name] = shown(layout.row, own, footnote, filter=name, baseline=report.baseline)
        if layout.name == "consistency" and (axes := [row for row in report.tables.consistency if row.whiteness]):
            found["innovations", ""] = table_of(
                "Innovations by axis: size, and correlation of each with the one before", axes, _INNOVATIONS
            )
    return found


_SHOWN_ROWS: Final[Mapping[str, Callable[[Any], object]]] = {
    "evidence": lambda row: row.baseline is not None or row.value is not None,
    "reference_error": lambda row: row.samples,
    "credibility": lambda row: row.samples,
    "consistency": lambda row: is_whole(row.measurement),
}
"""Which rows of a table people see, where it is not all."""
_INNOVATIONS: Final[tuple[Column, ...]] = (
    ("filter", "l", "filter"),
    ("measurement", "l", "measurement:words"),
    ("NIS / dof", "r", lambda row: number(row.mean_nis if row.mean_nis is None else row.mean_nis / row.dof)),
    ("verdict", "l", "verdict"),
    ("lag-1\ncorrelation", "r", "autocorrelation:2"),
    ("limit", "r", "autocorrelation_limit:2"),
    ("whiteness", "l", "whiteness"),
)


def _footnote(report: Report, table: str, name: str, rows: Sequence[Any]) -> str:
    """Return the footnote of a table, if it depends on the rows."""
    match table:
        case "evidence":
            # Early reports have no onboard solutions.
            is_read = bool(report.config.get("filters", {}).get(name, {}).get("solution"))
            return _how_measured(max(row.starts for row in rows), is_read=is_read)
        case "convergence":
            return (
                f"{report.baseline} reaches the target at {number(rows[0].baseline_s)} s. nearest: time at which the "
                f"sigma of {name} is nearest to the target, as Levy and Klein count. sigma may grow again after it."
            )
        case "reference_error":
            errors = of_filter(name, report.tables.reference_error)
            missing = _grouped((row.status, label(row.quantity)) for row in errors)
            missing.pop(ReferenceStatus.COMPARED, None)
            return "; ".join(
                status if len(found) == len(errors) else f"{status}: {', '.join(found)}"
                for status, found in missing.items()
            )
        case "consistency":
            return _in_spite((row.why, f"{row.filter} {row.measurement}") for row in rows)
        case "credibility":
            return (
                f"Expected NEES: 1 for one quantity, 3 for a group, {rows[-1].dof} for all. Shares: 68.3 % in 1 "
                "sd, 99.7 % in 3 sd. The reference is taken as exact. "
            ) + _in_spite((row.why, label(row.quantity)) for row in rows)
    return ""


def _how_measured(starts: int, *, is_read: bool) -> str:
    if is_read:
        begun = (
            f"The onboard solution has one start, the baseline {starts}. low and high allow for the scatter of starts."
            if starts > 1
            else "Both have one start, and the baseline's has no error (--starts 16 draws starts)."
        )
        return f"{begun} n: independent values behind the interval. The ratio of NEES is that of its distance from 1."
    drawn = (
        f"Values: this dive, from its own start. Ratio of accuracy: over {starts} drawn starts."
        if starts > 1
        else "One start without error, so the gain after an error of the start is not measured (--starts 16)."
    )
    return (
        f"{drawn} low, high: 95 % interval on this dive; other dives may differ by more. p below 0.01 decides. Rows in "
        "brackets have no vote. n: independent values behind the interval. The ratio of NIS and NEES is that of their "
        "distance from 1."
    )


def _grouped(named: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    groups: dict[str, list[str]] = {}
    for reason, name in named:
        groups.setdefault(reason, []).append(name)
    return groups


def _in_spite(named: Iterable[tuple[str, str]]) -> str:
    """State why a verdict differs from its interval."""
    reasons = _grouped(named)
    reasons.pop("", None)
    texts = "; ".join(f"{', '.join(found)} ({why})" for why, found in reasons.items())
    return f"Verdicts that differ from their interval: {texts}." if texts else ""


# --- The tables that `--table` names: for people, as CSV, as JSON.

TOGETHER: Final = ("pooled", "summary")
"""Names of the tables over all dives."""


def require_tables(names: Sequence[str]) -> None:
    """Raise a ConfigError, with the nearest name, if a table is not known."""
    known = [*(layout.name for layout in TABLES), *TOGETHER]
    for name in names:
        require_known("table", name, known, most=len(known))


def replay_result(
    found: Report | Sequence[Report],
    document: Sequence[Part],
    names: Sequence[str] = (),
    together: Mapping[str, tuple[type[Struct], Sequence[Struct]]] = {},
) -> Result:
    """Return the result of one dive or several; if tables are named, its data are their rows of all dives.

    ``together`` has the rows of tables over all dives, and their type.
    """
    reports = [found] if isinstance(found, Report) else found
    rows = {
        layout.name: (layout.row, [row for report in reports for row in getattr(report.tables, layout.name)])
        for layout in TABLES
    } | dict(together)
    blocks = {name: Block.of(*typed) for name, typed in rows.items()}
    title = reports[0].log.name if len(reports) == 1 else counted(len(reports), "dive")
    return Result(
        kind="replay",
        title=title,
        tables={name: block for name, block in blocks.items() if name in names or not (names or name in together)},
        block="" if len(names) == 1 else "table",
        document=[Only(PAGE, (Title(title),)), *document] if names else document,
        data={name: rows[name][1] for name in names if name in rows} if names else found,
    )


def tables_named(report: Report, *names: str) -> list[DisplayTable]:
    """Return some tables as shown."""
    wanted = (*names, *(["innovations"] if "consistency" in names else []))
    return [table for (name, _), table in tables_of(report).items() if name in wanted]


# --- The document, and the page.

MEANING: Final = "Background of panels over time: grey where the vehicle turns, ochre where the DVL has no velocity."


def dive_document(
    report: Report, first: Sequence[Part] = (), figures: Sequence[Part] = (), last: Sequence[Part] = ()
) -> list[Part]:
    """Return a report as a document: what was measured, then what the filters predict.

    ``first`` is between the verdict and the evidence, ``figures`` after the evidence, ``last`` after all tables.
    """
    found = tables_of(report)

    def named(*names: str) -> list[DisplayTable]:
        return [table for (name, _), table in found.items() if name in names]

    by_candidate, outage, references = named("evidence"), named("outage"), named("drift", "track_fit", "jumps")
    gains = ("improvement", "convergence", "reference_error")
    tables = [found[kind, name] for name in report.filters for kind in gains if (kind, name) in found]
    tables += named("consistency", "innovations", "credibility")
    glance = [dataclasses.replace(glance_table(report), links=())] if report.filters else []
    return [
        Only(PRINTED, (Title(heading(report)),)),
        Only(PAGE, (Title(_replayed(report)),)),
        *(Callout(candidate.sentence, TONES.get(candidate.verdict, "")) for candidate in report.filters.values()),
        *headline_table(report, "This run: position error and drift without DVL", SPECIFIED),
        *first,
        Only(PAGE, tuple(by_candidate)),
        *track_fit_line(report),
        *([] if has_reference(report) else [NO_REFERENCE]),
        Only(PRINTED, (*by_candidate, *outage)),
        Only(PRINTED_LONG, tuple(references)),
        *figures,
        Heading("Tables"),
        Only(PAGE, (*glance, *(dataclasses.replace(table, folded=True) for table in (*outage, *references, *tables)))),
        Only(PRINTED, (*tables, Sentences(closing_lines(report)))),
        *last,
    ]


def heading(report: Report) -> str:
    """Return a line with what was replayed, and the verdict and prediction of each candidate."""
    texts = [_replayed(report)]
    for name, candidate in report.filters.items():
        loud = candidate.verdict in (Verdict.WORSE, Verdict.NOT_EVALUATED)
        word = candidate.verdict.upper() if loud else candidate.verdict
        if candidate.verdict != Verdict.NOT_EVALUATED:
            prediction = f", {candidate.prediction}" if candidate.prediction != Prediction.UNDECIDED else ""
            word = f"{word}; {percent(candidate.mean_improvement_pct)} predicted{prediction}"
        texts.append(f"{name}: {word}")
    return "; ".join(texts)


def _replayed(report: Report) -> str:
    candidates = f"{', '.join(report.filters)} against " if report.filters else ""
    return f"{report.log.name}: {candidates}{report.baseline} over {report.log.duration_s:.1f} s"


def closing_lines(report: Report) -> tuple[str, ...]:
    """Return a line for each candidate with its mean predicted improvement."""
    consistency_words = "reference error and consistency" if has_reference(report) else "outage and consistency"
    return tuple(
        f"{name}: predicted by its own covariance, mean of nine states: "
        f"{percent(means.mean_improvement_pct)} smaller sigma, "
        f"{percent(means.mean_convergence_improvement_pct)} faster convergence "
        f"(a filter without any change has {percent(means.mean_convergence_unchanged_pct)}; by the nearest approach "
        f"{percent(means.mean_nearest_approach_improvement_pct)}). To check it, see {consistency_words}."
        for name, means in report.filters.items()
        if means.verdict != Verdict.NOT_EVALUATED
    )


def dive_page(report: Report, first: Sequence[Panel], figures: Sequence[Figure], strips: str, settings: str) -> bytes:
    """Return the page of a replay; the same replay gives the same bytes."""
    from insdvl_replay.show.page import HOW_TO_READ, captioned, facts, page, pictures, settings_details

    caption = "Line: median of the runs from all starts. Shaded: range of the runs. " if len(first) > 1 else ""
    sensors = captioned(
        "Data coverage",
        "Height: share of the time with valid samples. A dip is a gap.",
        strips,
    )
    log = report.log
    origin = {
        "log": log.name,
        "SHA-256 of the log": log.sha256 or "none",
        "span on the log's clock": f"{log.start_ns} to {log.end_ns} ns",
        "tool": f"{report.tool.name} {report.tool.version}",
        "packages": ", ".join(f"{name} {version}" for name, version in report.versions.items()),
    }
    channels = table_of(
        "Channels of the log",
        log.channels,
        (
            ("topic", "l", "topic"),
            ("type", "l", "type_name"),
            ("encoding", "l", "encoding"),
            ("role", "l", lambda channel: channel.role or "not used"),
            ("messages", "r", "messages"),
        ),
    )
    return page(
        dive_document(
            report,
            [pictures((*first, *_bars(report)), f"{caption}{HOW_TO_READ} {MEANING}")],
            [Heading("Figures"), *figures, Html(sensors)],
            [
                Heading("Notes"),
                notes_table(report.notes),
                Heading("Provenance"),
                facts(origin),
                channels,
                Code(changed_settings(report.config), "toml"),
                settings_details(settings),
            ],
        )
    )


def changed_settings(config: Mapping[str, Any]) -> str:
    """Write the settings that are not the defaults, a line each."""
    usual = dict(flattened(msgspec.to_builtins(Config())))
    lines = [f"{key} = {json.dumps(value)}" for key, value in flattened(config) if usual.get(key, ...) != value]
    return "\n".join(["# settings that differ from the defaults", *lines] if lines else ["# all settings are defaults"])


_MEASURED_BY: Final = {"phi_n": "level", "phi_e": "level", "phi_d": "heading"}
"""States whose errors have an evidence row, with the name of that row."""
_MOST_GAINS: Final = 2
_FULL_PCT: Final = 100.0
"""Longer bars end at the edge; the number next to them is complete."""


def _bars(report: Report) -> Iterator[str]:
    """Draw the predicted and the measured improvement of each candidate, where both are known."""
    gains = {name: list(_gains(report, name)) for name in report.filters}
    known = {name: found for name, found in gains.items() if found}
    rows = ""
    for name, found in known.items():
        rows += f'<tr><th scope="rowgroup" colspan="4"><b>{escape(visible(name))}</b></th></tr>'
        # With several candidates there is room for the mean and one state.
        for title, predicted_pct, measured_pct in found[: _MOST_GAINS if len(known) > 1 else None]:
            bars = ""
            for style, value_pct, top in (("predicted", predicted_pct, 1), ("measured", measured_pct, 9)):
                if value_pct is not None:
                    end = max(-_FULL_PCT, min(_FULL_PCT, value_pct))
                    place = f'x="{min(0.0, end):.1f}" y="{top}" width="{abs(end):.1f}" height="6"'
                    bars += f'<rect class="{style}" {place}/>'
            rows += (
                f'<tr><th scope="row">{escape(title)}</th><td class="r">{percent(predicted_pct)}</td>'
                f'<td class="r">{percent(measured_pct)}</td><td class="axis"><svg viewBox="-100 0 200 16" '
                f'preserveAspectRatio="none"><path class="zero" d="M0 0V16"/>{bars}</svg></td></tr>'
            )
    if known:
        yield (
            '<section><h3>improvement, <b>predicted</b> (blue) and <b>measured</b></h3><table class="bars"><thead>'
            '<tr><th>quantity</th><th class="r">predicted</th><th class="r">measured</th><th class="axis">'
            "<span>&minus;100&nbsp;%</span><span>0</span><span>100&nbsp;%</span></th></tr></thead>"
            f"<tbody>{rows}</tbody></table></section>"
        )


def _gains(report: Report, name: str) -> Iterator[tuple[str, Number, Number]]:
    """Yield label, predicted and measured improvement in percent, where both are known; the mean first."""
    if report.filters[name].verdict == Verdict.NOT_EVALUATED:
        return
    measured = {
        row.quantity: 100.0 * (1.0 - row.ratio)
        for row in report.tables.evidence
        if row.filter == name and row.evidence in ("accuracy", "outage") and row.ratio is not None
    }
    predicted_pct = report.filters[name].mean_improvement_pct
    for quantity, measured_pct in list(measured.items())[:1] if predicted_pct is not None else ():
        yield f"mean / {label(quantity)}", predicted_pct, measured_pct
    for row in of_filter(name, report.tables.improvement):
        quantity = _MEASURED_BY.get(row.state, "")
        if quantity in measured:
            axis = label(row.state).partition(", ")[2]
            yield quantity if quantity == "heading" else f"{quantity}, {axis}", row.improvement_pct, measured[quantity]


# --- What screens and pages have in common.

_CHOSEN: Final = ("velocity_along", "convergence_level", "nis")
"""Evidence rows that are shown as well as those that decided and the first of each kind."""


def over_starts(starts: int) -> str:
    """Say how values and ratio of accuracy rows differ; empty for one start."""
    return f"ratio: over {starts} drawn starts; values: this dive, from its own start" if starts > 1 else ""


def prediction_line(candidate: CandidateVerdict, evidence: Sequence[EvidenceRow], *, has_reference: bool) -> str:
    """State the predicted improvement of a candidate, and whether it is confirmed."""
    predicted_pct = candidate.mean_improvement_pct
    if predicted_pct is None and candidate.consistency == Consistency.NOT_AVAILABLE:
        return "predicted: unknown. An onboard solution reports the sigma of only some states, or of none."

    def gained(change: float | None, gain: str, loss: str) -> str:
        return f"{percent(-change)} {loss}" if change is not None and change < 0.0 else f"{percent(change)} {gain}"

    sigma = gained(predicted_pct, "smaller", "larger")
    convergence = gained(candidate.mean_convergence_improvement_pct, "faster", "slower")
    found = ""
    if finite(predicted_pct) >= NOTABLE_PCT:
        prediction = candidate.prediction or Prediction.UNDECIDED
        found = f" {on_prediction(prediction, evidence, has_reference=has_reference)}."
    return f"predicted: {sigma} sigma, {convergence} convergence.{found}"


def chosen_rows(rows: Sequence[P], most: int) -> list[P]:
    """Choose evidence rows: those that decided, the first of each kind, held-out sensors, then others."""
    known = [row for row in rows if row.baseline is not None or row.value is not None]
    first = {row.evidence: row.quantity for row in reversed(known)}

    def importance(row: P) -> tuple[bool, bool, bool, bool]:
        return (
            not (row.quantity in DECIDING and row.verdict in DECIDED),
            row.quantity not in (first[row.evidence], *HELD_OUT_QUANTITIES),
            row.quantity not in _CHOSEN,
            row.quantity not in DECIDING_TOGETHER,
        )

    quantities = list(dict.fromkeys(row.quantity for row in sorted(known, key=importance)))[:most]
    return [row for row in known if row.quantity in quantities]
