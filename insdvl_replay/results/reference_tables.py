"""What the reference says of single filters, for people: how large their errors are, and how their tracks would fit."""

from collections.abc import Iterator, Sequence
from typing import Final

from insdvl_replay.core.quantities import NAMES
from insdvl_replay.core.table_layout import Number, finite
from insdvl_replay.core.track_rows import DriftRow, JumpRow, TrackFitRow
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.report.document import MISSING, Column, DisplayTable, decimal, number, row_label, table_of
from insdvl_replay.results.json_report import Report

NO_REFERENCE: Final = (
    "There is no reference: how far the filters are off, how fast they really converge, whether their errors are as "
    "large as they say, and whether they gain what they believe cannot be told."
)
SPECIFIED: Final = (
    "Of distance: the final horizontal error. CEP50 and CEP95: half and 95 % of the horizontal errors of this run are "
    "smaller. Without DVL: median drift over the windows of the outage test, by the withheld velocities."
)
"""What the numbers of the headline are."""
_SIGN: Final = "\N{PLUS-MINUS SIGN}"
_FEWEST_DIGITS, _MOST_DIGITS = 2, 5


def has_reference(report: Report) -> bool:
    """Return whether the dive has a reference to compare with; early reports lack one of the tables that say so."""
    found = [row.verdict for row in report.tables.credibility] + [row.status for row in report.tables.reference_error]
    return any(word != ReferenceStatus.NO_REFERENCE for word in found)


def track_fit_line(report: Report) -> Iterator[str]:
    """State in a line what would lay the baseline's track on the reference's, where that is known."""
    fit = {row.quantity: row for row in report.tables.track_fit if row.filter == report.baseline}
    if fit:
        scale, turn = (f"{quantity} {_with_sd(fit[quantity])} {fit[quantity].unit}" for quantity in ("scale", "turn"))
        yield f"track fit: {scale}, {turn}"


def _with_sd(row: TrackFitRow) -> str:
    """Write a number with its standard error, to the first digit of that at least."""
    digits = next((n for n in range(_FEWEST_DIGITS, _MOST_DIGITS) if finite(row.fitted_sd) >= 10.0**-n), _FEWEST_DIGITS)
    sd = "" if row.fitted_sd is None else f" {_SIGN} {row.fitted_sd:.{digits}f}"
    return f"{finite(row.fitted):+.{digits}f}{sd}"


def headline_table(report: Report, title: str = "", footnote: str = "") -> Iterator[DisplayTable]:
    """Lay out what INS/DVL systems are specified by, a line for each filter: this run's own errors, where known."""
    position = {row.filter: row for row in report.tables.drift if row.quantity == "position_h"}
    outages = {(row.window_s, row.filter): row.drift_median_m for row in report.tables.coasting if row.windows}
    tested = {window_s for window_s, _ in outages}
    windows_s = [window_s for window_s in ("60", "120") if window_s in tested] or sorted(tested)[:1]
    header = ["this run", *(("of distance", "CEP50", "CEP95", "end") if position else ())]
    header += [f"{window_s} s{'' if i else ' without DVL'}" for i, window_s in enumerate(windows_s)]
    rows = []
    for name in (report.baseline, *report.filters):
        row = position.get(name)
        errors = [MISSING] * 4 if row is None else [_of_distance(row), *map(_metres, (row.p50, row.p95, row.final))]
        drifts = [_metres(outages.get((window_s, name))) for window_s in windows_s]
        rows.append((name, *(errors if position else ()), *drifts))
    if len(header) > 1:
        spare = tuple(range(len(header) - 1, 1, -1))
        yield DisplayTable(title, tuple(header), f"l{'r' * (len(header) - 1)}", tuple(rows), footnote, spare=spare)


def _of_distance(row: DriftRow) -> str:
    known = row.final_of_distance_pct is not None
    return f"{row.final_of_distance_pct:.2f} % of {row.distance_m:.0f} m" if known else MISSING


def _metres(value: Number) -> str:
    return MISSING if value is None else f"{value:.3g} m" if value < 1000.0 else f"{value:.0f} m"


def reference_tables(report: Report) -> list[DisplayTable]:
    """Lay out how far each filter is from the reference, nothing without one; and how often positions jump."""
    return [*_drift(report.tables.drift), *_track_fit(report.tables.track_fit), *_jumps(report.tables.jumps)]


def _drift(rows: Sequence[DriftRow]) -> Iterator[DisplayTable]:
    if rows:
        columns: list[Column[DriftRow]] = [
            ("quantity", "l", lambda row: NAMES.get(row.quantity) or row_label(row.quantity)),
            ("filter", "l", lambda row: row.filter),
            ("unit", "l", lambda row: row.unit),
            ("50 %", "r", lambda row: number(row.p50)),
            ("95 %", "r", lambda row: number(row.p95)),
            ("rms", "r", lambda row: number(row.rms)),
            ("worst", "r", lambda row: number(row.worst)),
            ("at [s]", "r", _when),
        ]
        by_quantity = dict.fromkeys(row.quantity for row in rows)
        in_order = [row for quantity in by_quantity for row in rows if row.quantity == quantity]
        yield table_of(
            "Drift: how far each filter is from the reference",
            in_order,
            columns,
            "50 % and 95 % of the sizes stay below; of the position these are CEP50 and CEP95. Drift: what the "
            "horizontal position error changes by over a stretch.",
        )


def _when(row: DriftRow) -> str:
    begin, end = row.worst_from_s, row.worst_to_s
    if begin is None or end is None:
        return MISSING
    return f"{begin:.0f}" if begin == end else f"{begin:.0f}\N{EN DASH}{end:.0f}"


def _jumps(rows: Sequence[JumpRow]) -> Iterator[DisplayTable]:
    if rows:
        columns: list[Column[JumpRow]] = [
            ("filter", "l", lambda row: row.filter),
            ("steps", "r", lambda row: str(row.steps)),
            ("jumps", "r", lambda row: str(row.jumps)),
            ("largest [m]", "r", lambda row: number(row.largest_m)),
            ("at [s]", "r", lambda row: decimal(row.largest_at_s, 1)),
        ]
        yield table_of(
            "Jumps: steps of the position that its own velocity does not explain",
            rows,
            columns,
            "What neither the velocity nor one of the three steps before and after explains of a horizontal step; a "
            "jump is more than 0.5 m and ten robust standard deviations of what usually is. Filters that go by their "
            "velocity alone have none.",
        )


def _track_fit(rows: Sequence[TrackFitRow]) -> Iterator[DisplayTable]:
    if rows:
        header = dict.fromkeys(f"{row.quantity} [{row.unit}]" for row in rows)
        by_filter = dict.fromkeys(row.filter for row in rows)
        yield DisplayTable(
            "Track fit: what would lay each track on the reference's",
            ("filter", *header),
            f"l{'r' * len(header)}",
            tuple((name, *(_with_sd(row) for row in rows if row.filter == name)) for name in by_filter),
            "Scale: positive where the filter's track is too small. Turn: clockwise from above. Standard errors allow "
            "for noise, and not for a heading that drifts.",
        )
