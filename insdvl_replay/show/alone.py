"""A filter without candidates: its errors, its drift and its consistency, in place of a verdict."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from insdvl_replay.core.quantities import is_used
from insdvl_replay.core.result import DisplayTable, Report
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import GateStatus
from insdvl_replay.evaluation.verdicts import consistency_of
from insdvl_replay.show.document import MISSING, significant

if TYPE_CHECKING:
    from insdvl_replay.show.dives import Outcome

_UNITS: Final = {
    "position rms": "m",
    "depth rms": "m",
    "velocity rms": "m/s",
    "drift in 60 s": "m",
    "60 s without DVL": "m",
    "NIS / dof": "",
}


def _values(report: Report) -> dict[str, str]:
    """Return the values that are known, by name."""
    tables = report.tables
    errors = {row.quantity: finite(row.rmse) for row in tables.reference_error}
    drifts = [row.rms for row in tables.drift if row.quantity == "drift_60s"]
    outages = [row.drift_median_m for row in tables.outage if row.window_s == "60"]
    sizes = [finite(row.mean_nis) / row.dof for row in tables.consistency if is_used(row.measurement)]
    found = {
        "position rms": errors.get("position_h"),
        "depth rms": errors.get("depth"),
        "velocity rms": math.hypot(*(errors.get(f"velocity_{axis}", math.nan) for axis in "ned")),
        "drift in 60 s": next(iter(drifts), None),
        "60 s without DVL": next(iter(outages), None),
        "NIS / dof": next(iter(sizes), None),
    }
    texts = {name: significant(value, 3) for name, value in found.items()}
    return {name: text for name, text in texts.items() if text != MISSING}


def line_alone(report: Report) -> str:
    """Return the values of the only filter in a line, such as ``position rms 0.22 m``."""
    texts = [f"{name} {value} {_UNITS[name]}".rstrip() for name, value in _values(report).items()]
    return f"{report.baseline}: {', '.join(texts)} ({consistency_of(report.tables.consistency, report.baseline)})"


def table_alone(outcomes: "Sequence[Outcome]") -> DisplayTable:
    """Return a row for each dive."""
    from insdvl_replay.show.dives import Failure  # whose page has this line, too

    rows = []
    for outcome in outcomes:
        if isinstance(outcome, Failure):
            rows.append((outcome.log, GateStatus.FAILED, *[MISSING] * (len(_UNITS) - 1)))
        else:
            values = _values(outcome)
            rows.append((outcome.log.name, *(values.get(name, MISSING) for name in _UNITS)))
    heads = (f"{name}\n[{unit}]" if unit else name for name, unit in _UNITS.items())
    return DisplayTable("", ("dive by dive", *heads), f"l{'r' * len(_UNITS)}", tuple(rows), "without DVL: the median")
