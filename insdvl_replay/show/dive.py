"""What people see of one dive: its tables in every format, its page, and what screens and pages have in common."""

import json
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import msgspec
from msgspec import Struct

from insdvl_replay.core.config import Config, flattened
from insdvl_replay.core.errors import counted, require_known
from insdvl_replay.core.quantities import WITHOUT_VERDICT, is_used, is_whole, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import (
    TABLES,
    ConsistencyRow,
    DriftRow,
    Number,
    ReferenceErrorRow,
    TableLayout,
    WhereRow,
    each_table,
    finite,
)
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.document.page import (
    captioned,
    facts,
    page,
    pictures,
    settings_details,
)
from insdvl_replay.document.parts import (
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
    Result,
    Title,
)
from insdvl_replay.document.tables import (
    MISSING,
    ShownColumn,
    notes_table,
    number,
    percent,
    shown,
    significant,
    table_of,
)
from insdvl_replay.evaluation.sentences import answer_lines, grounds, why_in_spite
from insdvl_replay.evaluation.verdicts import SHARED, consistency_of, trust_sentence
from insdvl_replay.show.answers import (
    TONES,
    answer_on_dive,
    has_reference,
    initial_text,
    of_filter,
    start_text,
)
from insdvl_replay.show.first_screen import (
    evidence_forest,
    first_screen,
    section,
)

NO_REFERENCE: Final = (
    "There is no reference, so true errors are unknown: accuracy, measured convergence, credibility and the predicted "
    "improvement cannot be checked."
)
# The meaning of the columns of the headline.
SPECIFIED: Final = (
    "share of distance: final horizontal error. CEP50, CEP95: 50 % and 95 % of the horizontal errors of this run are "
    "smaller. outage: median drift in the DVL outage test, measured by the held-out velocities."
)


# --- Tables.


def headline_table(report: Report, title: str = "", footnote: str = "") -> Iterator[DisplayTable]:
    """Return the errors of this run as INS/DVL systems are specified, a row for each filter, where known."""
    positions = {}
    for row in report.tables.drift:
        if row.quantity == "position_h":
            positions[row.filter] = row
    drifts_m: dict[str, dict[str, Number]] = {}  # by length of the windows, then by filter
    for outage in report.tables.outage:
        if outage.windows:
            drifts_m.setdefault(outage.window_s, {})[outage.filter] = outage.drift_median_m
    windows_s = _headline_windows(drifts_m)
    header = ["this run"]
    if positions:
        header += ["share of distance", "CEP50", "CEP95", "end"]
    heads = [f"{window_s} s" for window_s in windows_s]
    if heads:
        heads[0] = f"outage {heads[0]}: p50"
    header += heads
    if len(header) == 1:
        return
    rows = []
    for name in (report.baseline, *report.filters):
        cells = [name]
        if positions:
            cells += _position_cells(positions.get(name))
        for window_s in windows_s:
            cells.append(_metres(drifts_m[window_s].get(name)))
        rows.append(tuple(cells))
    alignment = f"l{'r' * (len(header) - 1)}"
    spare = tuple(range(len(header) - 1, 1, -1))
    yield DisplayTable(title, tuple(header), alignment, tuple(rows), footnote, spare=spare)


def _position_cells(row: DriftRow | None) -> list[str]:
    """Write the position error of a filter: its share of the distance, half and 95 % of it, at the end."""
    if row is None:
        return [MISSING] * 4
    share = MISSING
    if row.final_of_distance_pct is not None:
        share = f"{row.final_of_distance_pct:.2f} % of {row.distance_m:.0f} m"
    return [share, _metres(row.p50), _metres(row.p95), _metres(row.final)]


def _headline_windows(tested: Collection[str]) -> list[str]:
    """Return the lengths of the windows that are shown: those in which systems are specified, else the first."""
    usual = [window_s for window_s in ("60", "120") if window_s in tested]
    return usual or sorted(tested)[:1]


def _metres(value: Number) -> str:
    if value is None:
        return MISSING
    if value < 1000.0:
        return f"{value:.3g} m"
    return f"{value:.0f} m"


def track_fit_line(report: Report) -> Iterator[str]:
    """Return a line with the scale and the turn that align the baseline's track with the reference's, if known."""
    texts = []
    for row in of_filter(report.baseline, report.tables.track_fit):
        digits = _digits_of(row.fitted_sd)
        text = f"{row.quantity} {finite(row.fitted):+.{digits}f}"
        if row.fitted_sd is not None:
            text += f" \N{PLUS-MINUS SIGN} {row.fitted_sd:.{digits}f}"
        texts.append(f"{text} {row.unit}")
    if texts:
        yield f"track fit: {', '.join(texts)}"


def _digits_of(standard_error: Number) -> int:
    """Return two to four digits: to the first digit of the standard error at least."""
    for digits in range(2, 5):
        if finite(standard_error) >= 10.0**-digits:
            return digits
    return 2


# By column of the summary its name and unit, where a filter has no candidates.
VALUES: Final = {
    "position_h_rmse_m": ("position rms", "m"),
    "depth_rmse_m": ("depth rms", "m"),
    "velocity_rmse_mps": ("velocity rms", "m/s"),
    "drift_60s_rms_m": ("drift in 60 s", "m"),
    "outage_60s_drift_m": ("outage 60 s: p50", "m"),
    "nis_per_dof": ("NIS / dof", ""),
}


def values_of(report: Report, name: str) -> dict[str, float]:
    """Return the values of a filter by column of the summary, NaN where unknown."""
    tables = report.tables
    values = dict.fromkeys(VALUES, math.nan)
    errors = {row.quantity: finite(row.rmse) for row in of_filter(name, tables.reference_error)}
    velocity_mps = [errors.get(f"velocity_{axis}", math.nan) for axis in "ned"]
    values["position_h_rmse_m"] = errors.get("position_h", math.nan)
    values["depth_rmse_m"] = errors.get("depth", math.nan)
    values["velocity_rmse_mps"] = math.hypot(*velocity_mps)
    for drift in of_filter(name, tables.drift):
        if drift.quantity == "drift_60s":
            values["drift_60s_rms_m"] = finite(drift.rms)
            break
    for outage in of_filter(name, tables.outage):
        if outage.window_s == "60":
            values["outage_60s_drift_m"] = finite(outage.drift_median_m)
            break
    for row in of_filter(name, tables.consistency):
        if is_used(row.measurement):
            values["nis_per_dof"] = finite(row.mean_nis) / row.dof
            break
    return values


def line_alone(report: Report) -> str:
    """Return the values of the only filter in a line, such as ``position rms 0.22 m``."""
    texts = []
    for column, value in values_of(report, report.baseline).items():
        if not math.isnan(value):
            name, unit = VALUES[column]
            texts.append(f"{name} {significant(value, 3)} {unit}".rstrip())
    consistency = consistency_of(report.tables.consistency, report.baseline)
    return f"{report.baseline}: {', '.join(texts)} ({consistency})"


def tables_of(report: Report) -> dict[tuple[str, str], DisplayTable]:
    """Return the tables that have rows, as shown: by name, and by filter if each filter has its own."""
    found: dict[tuple[str, str], DisplayTable] = {}
    for layout, rows in each_table(report.tables):
        kept = _shown_rows(layout.name, rows)
        if layout.by_filter:
            for name in (report.baseline, *report.filters):
                own = of_filter(name, kept)
                if own:
                    found[layout.name, name] = _shown_table(report, layout, name, own)
        elif kept:
            found[layout.name, ""] = _shown_table(report, layout, "", kept)
        if layout.name == "consistency":
            axes = [row for row in report.tables.consistency if row.whiteness]
            if axes:
                found["innovations", ""] = table_of(
                    "Innovations by axis: size, and correlation of each with the one before",
                    axes,
                    _INNOVATIONS,
                )
    return found


def _shown_rows(table: str, rows: Sequence[Any]) -> list[Any]:
    """Return the rows of a table that people see, those of one quantity together where filters are in one table."""
    kept = list(filter(_SHOWN_ROWS.get(table), rows))
    if table == "drift":
        quantities = list(dict.fromkeys(row.quantity for row in kept))
        kept.sort(key=lambda row: quantities.index(row.quantity))
    return kept


def _shown_table(
    report: Report,
    layout: TableLayout,
    name: str,
    rows: Sequence[Any],
) -> DisplayTable:
    """Return a table, of one filter if it has a name; the baseline's errors are compared with nothing."""
    footnote = _footnote(report, layout.name, name, rows)
    if layout.name == "reference_error" and name == report.baseline:
        return table_of(f"Reference error of {name}", rows, _ERRORS_ALONE, footnote)
    return shown(layout.row, rows, footnote, filter=name, baseline=report.baseline)


def _nis_over_dof(row: ConsistencyRow) -> str:
    if row.mean_nis is None:
        return MISSING
    return number(row.mean_nis / row.dof)


# Which rows of a table people see, where it is not all.
_SHOWN_ROWS: Final[Mapping[str, Callable[[Any], object]]] = {
    "evidence": lambda row: row.baseline is not None or row.value is not None,
    "reference_error": lambda row: row.samples,
    "credibility": lambda row: row.samples,
    "consistency": lambda row: is_whole(row.measurement),
    "where": lambda row: row.ratio is not None,
}
_ERRORS_ALONE: Final[tuple[ShownColumn, ...]] = (
    ("", "l", "quantity:label"),
    ("", "l", "unit"),
    ("rms", "r", "rmse:value"),
    ("final", "r", "final:value"),
)
_INNOVATIONS: Final[tuple[ShownColumn, ...]] = (
    ("filter", "l", "filter"),
    ("measurement", "l", "measurement:words"),
    ("NIS / dof", "r", _nis_over_dof),
    ("verdict", "l", "verdict"),
    ("lag-1\ncorrelation", "r", "autocorrelation:2"),
    ("limit", "r", "autocorrelation_limit:2"),
    ("whiteness", "l", "whiteness"),
)


def _footnote(
    report: Report,
    table: str,
    name: str,
    rows: Sequence[Any],
) -> str:
    """Return the footnote of a table, if it depends on the rows."""
    match table:
        case "evidence":
            return (
                "Values: this dive, from its own start, after the sigma of the baseline has settled. acts: the "
                "difference of both runs over the error of the baseline; the ratio cannot differ from 1 by more. One "
                "dive has no verdict. The ratio of NIS and NEES is that of their distance from 1."
            )
        case "convergence":
            return _means_of_convergence(report, name, rows)
        case "reference_error":
            return _missing_errors(of_filter(name, report.tables.reference_error))
        case "consistency":
            return _in_spite(
                (why_in_spite(row.why), f"{row.filter} {row.measurement}") for row in rows
            )
        case "credibility":
            expected = (
                f"Expected NEES: 1 for one quantity, 3 for a group, {rows[-1].dof} for all. Shares: 68.3 % in 1 "
                "sd, 99.7 % in 3 sd. The reference is taken as exact. "
            )
            return expected + _in_spite(
                (why_in_spite(row.why), label(row.quantity)) for row in rows
            )
    return ""


def _means_of_convergence(report: Report, name: str, rows: Sequence[Any]) -> str:
    text = (
        f"{report.baseline} reaches the target at {number(rows[0].baseline_s)} s. nearest: time at which the "
        f"sigma of {name} is nearest to the target, as Levy and Klein count. sigma may grow again after it."
    )
    candidate = report.filters[name]
    if candidate.verdict in WITHOUT_VERDICT:
        return text
    return (
        f"{text} Mean of nine states: {percent(candidate.mean_improvement_pct)} smaller sigma at the end, reached "
        f"{percent(candidate.mean_convergence_improvement_pct)} faster; without any change "
        f"{percent(candidate.mean_convergence_unchanged_pct)}; by the nearest approach "
        f"{percent(candidate.mean_nearest_approach_improvement_pct)}."
    )


def _missing_errors(rows: Sequence[ReferenceErrorRow]) -> str:
    """State why errors are not known, and which, if it is not all of them."""
    reasons = _grouped((row.status, label(row.quantity)) for row in rows)
    reasons.pop(ReferenceStatus.COMPARED, None)
    texts = []
    for status, quantities in reasons.items():
        if len(quantities) == len(rows):
            texts.append(status)
        else:
            texts.append(f"{status}: {', '.join(quantities)}")
    return "; ".join(texts)


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
    if texts:
        return f"Verdicts that differ from their interval: {texts}."
    return ""


# --- The tables that `--table` names: for people, as CSV, as JSON.

TOGETHER: Final = ("answers", "pooled", "where", "summary")  # Names of the tables over all dives.


def require_tables(names: Sequence[str]) -> None:
    """Raise a ConfigError, with the nearest name, if a table is not known."""
    known = list(dict.fromkeys([*(layout.name for layout in TABLES), *TOGETHER]))
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
    title = reports[0].log.name if len(reports) == 1 else counted(len(reports), "dive")
    rows = _rows_by_table(reports) | dict(together)
    if not names:
        return Result(
            kind="replay",
            title=title,
            tables={name: Block.of(*rows[name]) for name in rows if name not in together},
            document=document,
            data=found,
        )
    return Result(
        kind="replay",
        title=title,
        tables={name: Block.of(*rows[name]) for name in rows if name in names},
        block="" if len(names) == 1 else "table",
        document=[Only(PAGE, (Title(title),)), *document],
        data={name: rows[name][1] for name in names if name in rows},
    )


def _rows_by_table(reports: Sequence[Report]) -> dict[str, tuple[type[Struct], Sequence[Struct]]]:
    """Return the rows of all dives, with their type, by table."""
    found: dict[str, tuple[type[Struct], Sequence[Struct]]] = {}
    for layout in TABLES:
        rows: list[Struct] = []
        for report in reports:
            rows += getattr(report.tables, layout.name)
        found[layout.name] = (layout.row, rows)
    return found


def tables_named(report: Report, *names: str) -> list[DisplayTable]:
    """Return some tables as shown."""
    wanted = set(names)
    if "consistency" in wanted:
        wanted.add("innovations")
    return [table for (name, _), table in tables_of(report).items() if name in wanted]


# --- The page, and the same document in other formats.

MEANING: Final = (
    "In panels over time the background is grey where the vehicle turns, and ochre where the DVL "
    "has no velocity."
)
# Rows of a forest plot, by the number of candidates; with more candidates the fewest rows, and no plot by what the
# vehicle does.
_MOST_ROWS: Final = {1: 14, 2: 10}
_FEWEST_ROWS: Final = 8


def dive_document(
    report: Report,
    panels: Sequence[Panel] = (),
    figures: Sequence[Part] = (),
    last: Sequence[Part] = (),
) -> list[Part]:
    """Return a report as a document: what was measured, then what the filters predict.

    ``panels`` are next to the verdicts, ``figures`` after the evidence, ``last`` after all tables.
    """
    found = tables_of(report)
    by_candidate = _named(found, "evidence")
    outage = _named(found, "outage")
    references = _named(found, "where", "drift", "track_fit", "jumps")
    tables = _tables_by_filter(report, found)
    tables += _named(found, "consistency", "innovations", "credibility")
    headline = list(
        headline_table(report, "This run: position error and drift without DVL", SPECIFIED)
    )
    parts: list[Part] = [Title(_title(report))]
    if not report.filters:
        parts.append(Callout(line_alone(report)))
    parts += [
        Only(PRINTED, (*_verdicts(report), *headline)),
        Only(PAGE, (*_first_screen(report, panels, headline), *by_candidate)),
        *track_fit_line(report),
    ]
    if not has_reference(report):
        parts.append(NO_REFERENCE)
    folded = [replace(table, folded=True) for table in (*outage, *references, *tables)]
    parts += [
        Only(PRINTED, (*by_candidate, *outage)),
        Only(PRINTED_LONG, tuple(references)),
        *figures,
        Heading("Tables"),
        Only(PAGE, tuple(folded)),
        Only(PRINTED, tuple(tables)),
        *last,
    ]
    return parts


def _named(found: Mapping[tuple[str, str], DisplayTable], *names: str) -> list[DisplayTable]:
    return [table for (name, _), table in found.items() if name in names]


def _tables_by_filter(
    report: Report, found: Mapping[tuple[str, str], DisplayTable]
) -> list[DisplayTable]:
    """Return what each candidate gains, or the errors of the only filter."""
    tables = []
    for name in [*report.filters] or [report.baseline]:
        for kind in ("improvement", "convergence", "reference_error"):
            if (kind, name) in found:
                tables.append(found[kind, name])
    return tables


def _title(report: Report) -> str:
    compared = report.baseline
    if report.filters:
        compared = f"{', '.join(report.filters)} against {report.baseline}"
    return f"{report.log.name}: {compared} over {report.log.duration_s:.1f} s"


def _verdicts(report: Report) -> Iterator[Callout]:
    for candidate in report.filters.values():
        yield Callout(candidate.sentence, TONES.get(candidate.verdict, ""))


def _first_screen(
    report: Report, panels: Sequence[Panel], headline: Sequence[DisplayTable]
) -> Iterator[Part]:
    """Yield the verdicts with their evidence, and next to them the panels and the headline."""
    sections = [dive_section(report, name) for name in report.filters]
    caption = ""
    if panels:
        caption = MEANING
    if len(panels) > 1:
        caption = (
            f"Errors over time are the median and the range of the runs from all starts. {caption}"
        )
    yield first_screen(
        sections, caption, pictures(panels), headline, explains_figures=bool(panels)
    )
    if has_reference(report) and report.config.get("reference", {}).get("independent") is False:
        yield SHARED


def dive_section(report: Report, name: str, title: str = "Evidence") -> str:
    """Return the section of a candidate on one dive."""
    answer = answer_on_dive(report, name)
    if answer.verdict in WITHOUT_VERDICT:
        return section(answer, [f"{answer.reason}. Settle this first."])
    lines = answer_lines(answer, initial_text(report.config), start_text([report]))
    sentences = [grounds(answer), *lines, trust_sentence(report.tables, name, report.baseline)]
    most = _MOST_ROWS.get(len(report.filters), _FEWEST_ROWS)
    where: list[WhereRow] = []
    if len(report.filters) in _MOST_ROWS:
        where = [row for row in of_filter(name, report.tables.where) if row.ratio is not None]
    return section(answer, sentences, [evidence_forest(title, answer, most, where)])


def dive_page(
    report: Report,
    first: Sequence[Panel],
    figures: Sequence[Figure],
    strips: str,
    settings: str,
) -> bytes:
    """Return the page of a replay; the same replay gives the same bytes."""
    sensors = captioned(
        "Data coverage", "Height: share of the time with valid samples. A dip is a gap.", strips
    )
    last = [
        Heading("Notes"),
        notes_table(report.notes),
        Heading("Provenance"),
        facts(_origin(report)),
        table_of("Channels of the log", report.log.channels, _CHANNELS),
        Code(changed_settings(report.config), "toml"),
        settings_details(settings),
    ]
    return page(dive_document(report, first, [Heading("Figures"), *figures, Html(sensors)], last))


_CHANNELS: Final[tuple[ShownColumn, ...]] = (
    ("topic", "l", "topic"),
    ("type", "l", "type_name"),
    ("encoding", "l", "encoding"),
    ("role", "l", lambda channel: channel.role or "not used"),
    ("messages", "r", "messages"),
)


def _origin(report: Report) -> dict[str, str]:
    """Return what a report is made of and by."""
    log = report.log
    versions = [f"{name} {version}" for name, version in report.versions.items()]
    return {
        "log": log.name,
        "SHA-256 of the log": log.sha256 or "none",
        "span on the log's clock": f"{log.start_ns} to {log.end_ns} ns",
        "tool": f"{report.tool.name} {report.tool.version}",
        "packages": ", ".join(versions),
    }


def changed_settings(config: Mapping[str, Any]) -> str:
    """Write the settings that are not the defaults, a line each."""
    usual = dict(flattened(msgspec.to_builtins(Config())))
    lines = []
    for key, value in flattened(config):
        if key not in usual or usual[key] != value:
            lines.append(f"{key} = {json.dumps(value)}")
    if lines:
        return "\n".join(["# settings that differ from the defaults", *lines])
    return "# all settings are defaults"
