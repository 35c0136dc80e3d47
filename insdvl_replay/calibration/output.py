"""A calibration as a fragment of configuration, as JSON and as CSV."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final

import msgspec
from msgspec import Struct

from insdvl_replay import __version__
from insdvl_replay.calibration.calibration import Calibration, ReferenceCalibration
from insdvl_replay.calibration.noise import INERTIAL
from insdvl_replay.calibration.parameters import PARAMETERS, REFERENCE_PARAMETERS, Geometry, Parameter
from insdvl_replay.calibration.rows import (
    CalibrationResult,
    NoiseRow,
    ParameterRow,
    ReferenceResult,
    ReferenceSettings,
    Settings,
    StartRow,
)
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.core.errors import visible
from insdvl_replay.core.quantities import AXES
from insdvl_replay.core.words import Estimated
from insdvl_replay.preparation.run import FIT
from insdvl_replay.report.csv_tables import blocks_csv
from insdvl_replay.report.document import counted
from insdvl_replay.results.json_report import as_json, package_versions, this_tool

KEYS: Final = {
    "delay": "latency_s",
    "arm": "lever_arm_m",
    "mounting": "mounting_rpy_deg",
    "scale": "scale",
}
"""Key in ``[dvl]`` of each group of parameters."""
REFERENCE_KEYS: Final = {
    "reference_clock": "latency_s",
    "reference_arm": "lever_arm_m",
    "reference_mounting": "mounting_rpy_deg",
}
"""Likewise in ``[reference]``."""
DIGITS: Final = 6
"""Decimals that are proposed; none of the numbers is known so well."""


def calibration_json(found: Calibration, config: Config) -> bytes:
    """Write a calibration as JSON. The same dives give the same bytes."""
    return as_json(
        CalibrationResult(
            this_tool(),
            package_versions(),
            _settings(found.before),
            _settings(found.after),
            list(found.rows),
            list(found.noise_rows),
            list(found.dives),
            list(found.held_out),
            _reference(found.reference),
            list(found.doubts),
            msgspec.to_builtins(config),
        )
    )


def _settings(geometry: Geometry) -> Settings:
    return Settings(geometry.latency_s, geometry.lever_arm_m, geometry.mounting_rpy_deg, geometry.scale)


def _reference(found: ReferenceCalibration | None) -> ReferenceResult | None:
    if found is None:
        return None
    before, after = (
        ReferenceSettings(settings.latency_s, settings.lever_arm_m, settings.mounting_rpy_deg)
        for settings in (found.before, found.after)
    )
    return ReferenceResult(before, after, list(found.rows), list(found.dives), list(found.starts))


def calibration_csv(found: Calibration) -> str:
    """Write the parameters, the dives, those held out and what the references say one after the other."""
    reference = found.reference
    tables: dict[str, Sequence[Struct]] = {
        "parameters": found.all_rows,
        "noise": found.noise_rows,
        "dives": found.dives,
        "held_out": found.held_out,
        "reference": () if reference is None else reference.dives,
        "starts": () if reference is None else reference.starts,
    }
    return blocks_csv(
        "table",
        {
            name: (list(_by_axis(rows[0])), (tuple(_by_axis(row).values()) for row in rows))
            for name, rows in tables.items()
            if rows
        },
    )


def _by_axis(row: Struct) -> dict[str, Any]:
    """Give each axis a column of its own."""
    found: dict[str, Any] = {}
    for name, value in msgspec.structs.asdict(row).items():
        found |= (
            dict(zip((f"{name}_{axis}" for axis in AXES), value, strict=True))
            if isinstance(value, tuple)
            else {name: value}
        )
    return found


def calibration_toml(found: Calibration, started_ns: Sequence[int]) -> str:
    """Write what is proposed as settings that ``-c`` reads, each with how sure it is and why.

    Parameters
    ----------
    started_ns : sequence of int
        When the dives began, ns since 1970; on their own clocks.
    """
    days = sorted({datetime.fromtimestamp(start_ns / NS_PER_S, UTC).date().isoformat() for start_ns in started_ns})
    names = ", ".join(visible(dive.dive) for dive in found.dives)
    head = (
        f"# insdvl-replay {__version__} calibrate: {counted(len(found.dives), 'dive')} of {days[0]}"
        f"{f' to {days[-1]}' if len(days) > 1 else ''}: {names}"
    )
    lines = ["[dvl]", *_lines(KEYS, PARAMETERS, found.rows, found)]
    inertial = [row for row in found.noise_rows if row.parameter in INERTIAL]
    lines += _noise_lines(row for row in found.noise_rows if row not in inertial)
    if found.proposes_noise:
        lines += ["", "[noise]", *_noise_lines(inertial)]
    if (reference := found.reference) is not None:
        lines += ["", "[reference]", *_lines(REFERENCE_KEYS, REFERENCE_PARAMETERS, reference.rows, reference)]
        lines += _initial(reference.starts)
    return "\n".join([head, *lines, *(f"# doubt: {visible(doubt)}" for doubt in found.doubts)]) + "\n"


def _lines(
    keys: Mapping[str, str],
    parameters: Sequence[Parameter],
    all_rows: Sequence[ParameterRow],
    found: Calibration | ReferenceCalibration,
) -> Iterator[str]:
    for group, key in keys.items():
        rows = [row for row, parameter in zip(all_rows, parameters, strict=True) if parameter.group == group]
        is_moved = getattr(found.before, key) != getattr(found.after, key)
        if all(row.status == Estimated.NOT_ASKED for row in rows) and not is_moved:
            continue
        yield from (f"# {_in_words(row)}" for row in rows)
        if is_moved or any(row.status == Estimated.ESTIMATED for row in rows):
            yield f"{key} = {toml_value(_rounded(getattr(found.before, key), getattr(found.after, key)))}"


def _noise_lines(rows: Iterable[NoiseRow]) -> Iterator[str]:
    for row in rows:
        sd = "" if row.sd is None else f", sd {row.sd:.2g} {row.unit}"
        of_class = f", class {row.sensor_class}" if row.sensor_class else ""
        if row.status == Estimated.ESTIMATED:
            yield f"# the innovations are likeliest with it{sd}; it was {row.before:.4g} {row.unit}{of_class}"
        elif row.status in (Estimated.NOT_DETERMINED, Estimated.DOUBTFUL):
            yield f"# {row.parameter}: {row.why}; it was {row.before:.4g} {row.unit}"
        if row.is_proposed:
            yield f"{row.parameter} = {toml_value(row.after)}"


def _initial(starts: Sequence[StartRow]) -> Iterator[str]:
    """Let each dive find its own heading, and tell what these found."""
    if starts:
        yield from ("", "[initial]")
        for start in starts:
            yield (
                f"# {visible(start.dive)}: {start.heading_deg:g} deg, sd {start.heading_sd_deg:.2g} deg, and a bias of "
                f"the gyro about down of {start.gyro_bias_degph:g} deg/h, sd {start.gyro_bias_sd_degph:.2g} deg/h"
            )
        yield f"heading_deg = {toml_value(FIT)}"


def _rounded(before: Any, after: Any) -> Any:
    """Leave out digits that mean nothing; what has not moved stays to the bit."""
    if isinstance(after, tuple):
        return tuple(_rounded(*pair) for pair in zip(before, after, strict=True))
    return after if after == before else round(after, DIGITS)


def _in_words(row: ParameterRow) -> str:
    match row.status:
        case Estimated.NOT_ASKED:
            return f"{row.parameter}: not asked"
        case Estimated.HELD | Estimated.NOT_DETERMINED:
            return f"{row.parameter}: as it was; {row.why}"
        case Estimated.DOUBTFUL:
            return f"{row.parameter}: {row.change:+.4g} {row.unit} was found and is not proposed: {row.why}"
        case Estimated.ESTIMATED:
            return (
                f"{row.parameter}: {row.change:+.4g} {row.unit}, sd {row.sd:.2g} {row.unit}, "
                f"signal to noise {row.signal_to_noise:.0f}"
            )
