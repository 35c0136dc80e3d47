"""What people see of one dive: its tables in every format, its page, and what screens and pages have in common."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import msgspec
from msgspec import Struct

from insdvl_replay.core.config import Config, flattened
from insdvl_replay.core.errors import counted, require_known
from insdvl_replay.core.quantities import WITHOUT_VERDICT, is_used, is_whole, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import TABLES, Number, each_table, finite
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.document.page import (
    HOW_TO_READ,
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
from insdvl_replay.evaluation.sentences import answer_lines, grounds
from insdvl_replay.evaluation.verdicts import SHARED, consistency_of, trust_sentence
from insdvl_replay.show.answers import (
    TONES,
    answer_on_dive,
    has_reference,
    initial_text,
    of_filter,
    start_text,
)
from insdvl_replay.show.first_screen import evidence_forest, first_screen, section

NO_REFERENCE: Final = (
    "There is no reference, so true errors are unknown: accuracy, measured convergence, credibility and the predicted "
    "improvement cannot be checked."
)
# The meaning of the columns of the headline.
SPECIFIED: Final = (
    "of distance: final horizontal error. CEP50, CEP95: 50 % and 95 % of the horizontal errors of this run are "
    "smaller. without DVL: median drift in the DVL outage test, measured by the held-out velocities."
)


# --- Tables.


def headline_table(report: Report, title: str = "", footnote: str = "") -> Iterator[DisplayTable]:
    """Return the errors of this run as INS/DVL systems are specified, a row for each filter, where known."""
    position = {row.filter: row for row in report.tables.drift if row.quantity == "position_h"}
    outages = {
        (row.window_s, row.filter): row.drift_median_m
        for row in report.tables.outage
        if row.windows
    }
    tested = {window_s for window_s, _ in outages}
    windows_s = [window_s for window_s in ("60", "120") if window_s in tested] or sorted(tested)[:1]
    header = ["this run", *(("of distance", "CEP50", "CEP95", "end") if position else ())]
    header += [f"{window_s} s{'' if i else ' without DVL'}" for i, window_s in enumerate(windows_s)]

    def metres(value: Number) -> str:
        if value is None:
            return MISSING
        if value < 1000.0:
            return f"{value:.3g} m"
        return f"{value:.0f} m"

    rows = []
    for name in (report.baseline, *report.filters):
        row = position.get(name)
        errors = [MISSING] * 4
        if row is not None:
            pct = row.final_of_distance_pct
            distance_m = row.distance_m
            of_distance = MISSING if pct is None else f"{pct:.2f} % of {distance_m:.0f} m"
            errors = [of_distance, *map(metres, (row.p50, row.p95, row.final))]
        rows.append(
            (
                name,
                *(errors if position else ()),
                *(metres(outages.get((at, name))) for at in windows_s),
            )
        )
    if len(header) > 1:
        spare = tuple(range(len(header) - 1, 1, -1))
        yield DisplayTable(
            title, tuple(header), f"l{'r' * (len(header) - 1)}", tuple(rows), footnote, spare=spare
        )


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


# By column of the summary its name and unit, where a filter has no candidates.
VALUES: Final = {
    "position_h_rmse_m": ("position rms", "m"),
    "depth_rmse_m": ("depth rms", "m"),
    "velocity_rmse_mps": ("velocity rms", "m/s"),
    "drift_60s_rms_m": ("drift in 60 s", "m"),
    "outage_60s_drift_m": ("60 s without DVL", "m"),
    "nis_per_dof": ("NIS / dof", ""),
}


def values_of(report: Report, name: str) -> dict[str, float]:
    """Return the values of a filter by column of the summary, NaN where unknown."""
    tables = report.tables
    errors = {row.quantity: finite(row.rmse) for row in of_filter(name, tables.reference_error)}
    drifts = [row.rms for row in of_filter(name, tables.drift) if row.quantity == "drift_60s"]
    outages = [row.drift_median_m for row in of_filter(name, tables.outage) if row.window_s == "60"]
    sizes = [
        finite(row.mean_nis) / row.dof
        for row in of_filter(name, tables.consistency)
        if is_used(row.measurement)
    ]
    return {
        "position_h_rmse_m": errors.get("position_h", math.nan),
        "depth_rmse_m": errors.get("depth", math.nan),
        "velocity_rmse_mps": math.hypot(
            *(errors.get(f"velocity_{axis}", math.nan) for axis in "ned")
        ),
        "drift_60s_rms_m": finite(next(iter(drifts), None)),
        "outage_60s_drift_m": finite(next(iter(outages), None)),
        "nis_per_dof": next(iter(sizes), math.nan),
    }


def line_alone(report: Report) -> str:
    """Return the values of the only filter in a line, such as ``position rms 0.22 m``."""
    found = (
        (VALUES[column], value) for column, value in values_of(report, report.baseline).items()
    )
    texts = [
        f"{name} {significant(value, 3)} {unit}".rstrip()
        for (name, unit), value in found
        if value == value
    ]
    return f"{report.baseline}: {', '.join(texts)} ({consistency_of(report.tables.consistency, report.baseline)})"


def tables_of(report: Report) -> dict[tuple[str, str], DisplayTable]:
    """Return the tables that have rows, as shown: by name, and by filter if each filter has its own."""
    found: dict[tuple[str, str], DisplayTable] = {}
    for layout, rows in each_table(report.tables):
        kept: list[Any] = list(filter(_SHOWN_ROWS.get(layout.name), rows))
        if layout.name == "drift":
            quantities = list(dict.fromkeys(row.quantity for row in kept))
            kept.sort(key=lambda row: quantities.index(row.quantity))
        is_apart = layout.by_filter
        for name in (report.baseline, *report.filters) if is_apart else ("",):
            if own := of_filter(name, kept) if is_apart else kept:
                footnote = _footnote(report, layout.name, name, own)
                found[layout.name, name] = shown(
                    layout.row, own, footnote, filter=name, baseline=report.baseline
                )
                if layout.name == "reference_error" and name == report.baseline:
                    found[layout.name, name] = table_of(
                        f"Reference error of {name}", own, _ERRORS_ALONE, footnote
                    )
        if layout.name == "consistency" and (
            axes := [row for row in report.tables.consistency if row.whiteness]
        ):
            found["innovations", ""] = table_of(
                "Innovations by axis: size, and correlation of each with the one before",
                axes,
                _INNOVATIONS,
            )
    return found


# Which rows of a table people see, where it is not all.
_SHOWN_ROWS: Final[Mapping[str, Callable[[Any], object]]] = {
    "evidence": lambda row: row.baseline is not None or row.value is not None,
    "reference_error": lambda row: row.samples,
    "credibility": lambda row: row.samples,
    "consistency": lambda row: is_whole(row.measurement),
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
    (
        "NIS / dof",
        "r",
        lambda row: number(row.mean_nis if row.mean_nis is None else row.mean_nis / row.dof),
    ),
    ("verdict", "l", "verdict"),
    ("lag-1\ncorrelation", "r", "autocorrelation:2"),
    ("limit", "r", "autocorrelation_limit:2"),
    ("whiteness", "l", "whiteness"),
)


def _footnote(report: Report, table: str, name: str, rows: Sequence[Any]) -> str:
    """Return the footnote of a table, if it depends on the rows."""
    match table:
        case "evidence":
            return (
                "Values: this dive, from its own start, after the sigma of the baseline has settled. acts: the "
                "difference of both runs over the error of the baseline; the ratio cannot differ from 1 by more. One "
                "dive has no verdict. The ratio of NIS and NEES is that of their distance from 1."
            )
        case "convergence":
            candidate = report.filters[name]
            means = (
                f" Mean of nine states: {percent(candidate.mean_improvement_pct)} smaller sigma at the end, reached "
                f"{percent(candidate.mean_convergence_improvement_pct)} faster; without any change "
                f"{percent(candidate.mean_convergence_unchanged_pct)}; by the nearest approach "
                f"{percent(candidate.mean_nearest_approach_improvement_pct)}."
            )
            return (
                f"{report.baseline} reaches the target at {number(rows[0].baseline_s)} s. nearest: time at which the "
                f"sigma of {name} is nearest to the target, as Levy and Klein count. sigma may grow again after it."
                f"{means if candidate.verdict not in WITHOUT_VERDICT else ''}"
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

TOGETHER: Final = ("answers", "pooled", "summary")  # Names of the tables over all dives.


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
        layout.name: (
            layout.row,
            [row for report in reports for row in getattr(report.tables, layout.name)],
        )
        for layout in TABLES
    } | dict(together)
    blocks = {name: Block.of(*typed) for name, typed in rows.items()}
    title = reports[0].log.name if len(reports) == 1 else counted(len(reports), "dive")
    return Result(
        kind="replay",
        title=title,
        tables={
            name: block
            for name, block in blocks.items()
            if name in names or not (names or name in together)
        },
        block="" if len(names) == 1 else "table",
        document=[Only(PAGE, (Title(title),)), *document] if names else document,
        data={name: rows[name][1] for name in names if name in rows} if names else found,
    )


def tables_named(report: Report, *names: str) -> list[DisplayTable]:
    """Return some tables as shown."""
    wanted = (*names, *(["innovations"] if "consistency" in names else []))
    return [table for (name, _), table in tables_of(report).items() if name in wanted]


# --- The page, and the same document in other formats.

MEANING: Final = "Background of panels over time: grey where the vehicle turns, ochre where the DVL has no velocity."
# Rows of a forest plot, by the number of candidates; with more candidates the fewest rows.
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

    def named(*names: str) -> list[DisplayTable]:
        return [table for (name, _), table in found.items() if name in names]

    by_candidate = named("evidence")
    outage = named("outage")
    references = named("drift", "track_fit", "jumps")
    gains = ("improvement", "convergence", "reference_error")
    names = [*report.filters] or [report.baseline]
    tables = [found[kind, name] for name in names for kind in gains if (kind, name) in found]
    tables += named("consistency", "innovations", "credibility")
    verdicts = (
        Callout(candidate.sentence, TONES.get(candidate.verdict, ""))
        for candidate in report.filters.values()
    )
    headline = list(
        headline_table(report, "This run: position error and drift without DVL", SPECIFIED)
    )
    candidates = f"{', '.join(report.filters)} against " if report.filters else ""
    return [
        Title(
            f"{report.log.name}: {candidates}{report.baseline} over {report.log.duration_s:.1f} s"
        ),
        *([] if report.filters else [Callout(line_alone(report))]),
        Only(PRINTED, (*verdicts, *headline)),
        Only(PAGE, (*_first_screen(report, panels, headline), *by_candidate)),
        *track_fit_line(report),
        *([] if has_reference(report) else [NO_REFERENCE]),
        Only(PRINTED, (*by_candidate, *outage)),
        Only(PRINTED_LONG, tuple(references)),
        *figures,
        Heading("Tables"),
        Only(PAGE, tuple(replace(table, folded=True) for table in (*outage, *references, *tables))),
        Only(PRINTED, tuple(tables)),
        *last,
    ]


def _first_screen(
    report: Report, panels: Sequence[Panel], headline: Sequence[DisplayTable]
) -> Iterator[Part]:
    """Yield the verdicts with their evidence, and next to them the panels and the headline."""
    sections = [dive_section(report, name) for name in report.filters]
    runs = (
        "Errors over time: median and range of the runs from all starts. "
        if len(panels) > 1
        else ""
    )
    caption = f"{runs}{HOW_TO_READ} {MEANING}" if panels else ""
    yield first_screen(sections, caption, pictures(panels), headline, explains_figures=bool(panels))
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
    return section(answer, sentences, [evidence_forest(title, answer, most)])


def dive_page(
    report: Report, first: Sequence[Panel], figures: Sequence[Figure], strips: str, settings: str
) -> bytes:
    """Return the page of a replay; the same replay gives the same bytes."""
    sensors = captioned(
        "Data coverage", "Height: share of the time with valid samples. A dip is a gap.", strips
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
            first,
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
    lines = [
        f"{key} = {json.dumps(value)}"
        for key, value in flattened(config)
        if usual.get(key, ...) != value
    ]
    return "\n".join(
        ["# settings that differ from the defaults", *lines]
        if lines
        else ["# all settings are defaults"]
    )
