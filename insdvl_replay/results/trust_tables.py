"""The tables that say how far each filter is to be trusted: NIS of its innovations, NEES of its errors."""

from collections.abc import Iterable, Iterator, Sequence

from insdvl_replay.core.rows import (
    ConsistencyRow,
    CredibilityRow,
)
from insdvl_replay.report.document import (
    Column,
    DisplayTable,
    decimal,
    number,
    row_label,
    table_of,
)


def consistency_tables(rows: Sequence[ConsistencyRow]) -> Iterator[DisplayTable]:
    """Lay out NIS and verdict of each measurement; nothing without rows."""
    if rows:
        columns: list[Column[ConsistencyRow]] = [
            ("filter", "l", lambda row: row.filter),
            ("measurement", "l", lambda row: row.measurement),
            ("used", "r", lambda row: str(row.used)),
            ("rejected", "r", lambda row: str(row.rejected)),
            ("NIS", "r", lambda row: number(row.mean_nis)),
            ("low", "r", lambda row: number(row.low)),
            ("high", "r", lambda row: number(row.high)),
            ("verdict", "l", lambda row: row.verdict),
        ]
        title = "Consistency: mean NIS and where 95 % of consistent filters would have it"
        names = [(f"{row.filter} {row.measurement}", row.why) for row in rows]
        yield table_of(title, rows, columns, _in_spite(names))


def _in_spite(names: Iterable[tuple[str, str]]) -> str:
    """State why verdicts are not what the interval beside them says."""
    reasons: dict[str, list[str]] = {}
    for name, why in names:
        reasons.setdefault(why, []).append(name)
    reasons.pop("", None)
    named = "; ".join(f"{why}: {', '.join(found)}" for why, found in reasons.items())
    return f"In spite of the interval, {named}." if named else ""


def innovations_tables(rows: Sequence[ConsistencyRow]) -> Iterator[DisplayTable]:
    """Lay out mean, size and whiteness of the innovations; nothing without rows."""
    if rows:
        columns: list[Column[ConsistencyRow]] = [
            ("filter", "l", lambda row: row.filter),
            ("measurement", "l", lambda row: row.measurement.replace("_", " ")),
            ("NIS / dof", "r", lambda row: number(row.mean_nis if row.mean_nis is None else row.mean_nis / row.dof)),
            ("verdict", "l", lambda row: row.verdict),
            ("likeness", "r", lambda row: decimal(row.autocorrelation, 2)),
            ("limit", "r", lambda row: decimal(row.autocorrelation_limit, 2)),
            ("whiteness", "l", lambda row: row.whiteness),
        ]
        yield table_of("Innovations by axis: size, and likeness of each to the one before", rows, columns)


def credibility_tables(name: str, rows: Sequence[CredibilityRow]) -> Iterator[DisplayTable]:
    """Lay out NEES and coverage of a filter's states; nothing where none was compared."""
    compared = [row for row in rows if row.samples]
    if compared:
        columns: list[Column[CredibilityRow]] = [
            ("quantity", "l", lambda row: row_label(row.quantity).replace("accelerometer", "accel.")),
            ("NEES", "r", lambda row: number(row.mean_nees)),
            ("low", "r", lambda row: decimal(row.low, 2)),
            ("high", "r", lambda row: decimal(row.high, 2)),
            ("in\n1 sd", "r", lambda row: decimal(row.within_1sd_pct, 1)),
            ("in\n3 sd", "r", lambda row: decimal(row.within_3sd_pct, 1)),
            ("indep.", "r", lambda row: decimal(row.effective_samples, 0)),
            ("verdict", "l", lambda row: row.verdict),
        ]
        yield table_of(
            f"Credibility: errors of {name} in its own standard deviations",
            compared,
            columns,
            f"Expected: NEES 1, of a group 3, all together {compared[-1].dof}; 68.3 % and 99.7 %. The "
            "reference is taken as exact. indep.: samples that do not repeat each other. "
            + _in_spite([(row_label(row.quantity), row.why) for row in compared]),
        )
