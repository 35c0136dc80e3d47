"""Expected values: what `check --update` stores of a dive, and which causes they show for a gate that fails."""

from collections.abc import Iterator, Sequence
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from zipfile import BadZipFile, ZipFile, ZipInfo

import msgspec

from insdvl_replay.changes.cells import changed_settings
from insdvl_replay.changes.gate_file import LOG, CellGate, Gate, Gates, TrajectoryGate
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import ConfigError, UserError, listed, looked_for
from insdvl_replay.core.result import Row, StoredLog, StoredReport, as_json, flattened
from insdvl_replay.core.tables import CANDIDATES
from insdvl_replay.core.words import GateLevel
from insdvl_replay.results.folder import TRAJECTORY_FILE, read_file, result_file
from insdvl_replay.results.stored_results import read_results

if TYPE_CHECKING:
    # Trajectories need numpy, and a check of tables alone must not wait for it.
    from insdvl_replay.changes.gates import Checked
    from insdvl_replay.results.trajectory import Trajectory

MOST_CAUSES: Final = 4  # settings that a failure names
_FILTERS: Final = "filters"  # key of the names of all filters, among the settings
_SETTINGS_FILE: Final = "settings.json"  # in the archive of a trajectory
_HASH_DIGITS: Final = 12


# --- Read.


def expected_path(gates: Gates, gate: Gate, dive: str) -> Path:
    """Return where the expected values of a dive are stored."""
    return gates.path.parent / (gate.expected or "").replace(LOG, dive)


def stored_values(gate: Gate, path: Path) -> "StoredReport | Trajectory | None":
    """Read expected values; None if there are none, or the file is something else."""
    if isinstance(gate, TrajectoryGate):
        from insdvl_replay.results.trajectory import read_trajectory

        return read_trajectory(path)
    try:
        return read_results(path)[0][0].report
    except UserError:
        return None


def expected_of(gates: Gates, gate: Gate, log: StoredLog) -> "StoredReport | Trajectory":
    """Return the expected values of a log; the ConfigError names the command that writes them."""
    path, command = expected_path(gates, gate, log.name), f"`insdvl-replay check {gates.path} --update`"
    with looked_for(path):
        if not path.is_file():
            raise ConfigError(f"{path}: there are no expected values yet", f"{command} writes them")
    expected = stored_values(gate, path)
    if expected is None:
        kind = "trajectory" if isinstance(gate, TrajectoryGate) else "result"
        raise ConfigError(f"{path}: is not a readable {kind}", f"{command} writes a new one")
    if (expected.log.sha256 if isinstance(expected, StoredReport) else expected.sha256) != log.sha256:
        text = f"{path}: the expected values are of another log than {log.name}"
        raise ConfigError(text, f"{command} writes new ones")
    return expected


def known_causes(gates: Gates, dive: str, report: StoredReport) -> tuple[str, ...]:
    """Say what differs from the replay that gave the expected values: log, version of the tool, settings."""
    gated = [gate for gate in gates.gates if gate.expected is not None and gate.applies_to(dive)]
    found = (_stored_settings(gate, expected_path(gates, gate, dive)) for gate in gated)
    stored = next((values for values in found if values is not None), None)
    if stored is None:
        return ()
    causes, (old, new) = list[str](), ((values.log.sha256, values.tool.get("version")) for values in (stored, report))
    if old[0] != new[0]:
        causes.append(f"the log differs: SHA-256 {old[0][:_HASH_DIGITS]} -> {new[0][:_HASH_DIGITS]}")
    if old[1] and new[1] and old[1] != new[1]:
        causes.append(f"the version of the tool differs: {old[1]} -> {new[1]}")
    was, is_ = (_own_settings(values) for values in (stored, report))
    if stored.config and was != is_:
        causes.append(f"settings differ: {listed(changed_settings(was, is_, _defaults()), MOST_CAUSES)}")
    return tuple(causes)


def _stored_settings(gate: Gate, path: Path) -> StoredReport | None:
    """Read the settings that are stored with expected values; a file of a trajectory has them in a file of its own."""
    if isinstance(gate, CellGate):
        values = stored_values(gate, path)
        return values if isinstance(values, StoredReport) else None
    try:
        with ZipFile(BytesIO(read_file(path))) as arrays:
            return msgspec.json.decode(arrays.read(_SETTINGS_FILE), type=StoredReport)
    except (OSError, KeyError, BadZipFile, msgspec.DecodeError):
        return None


# --- Write.


def with_expected(gates: Gates, dives: Sequence["Checked"]) -> Iterator[tuple[Gate, "Checked", StoredReport]]:
    """Yield each gate that has expected values, with each dive that it applies to and its result."""
    for gate in gates.gates:
        if gate.expected is not None and gate.level != GateLevel.OFF:
            for dive in dives:
                if isinstance(dive.result, StoredReport) and gate.applies_to(dive.name):
                    yield gate, dive, dive.result


def write_expected(gates: Gates, dives: Sequence["Checked"]) -> list[Path]:
    """Store the gated values and trajectories; return the files."""
    written: dict[Path, tuple[Checked, StoredReport, list[Gate]]] = {}
    for gate, dive, report in with_expected(gates, dives):
        path = expected_path(gates, gate, dive.name)
        owner, _, sharing = written.setdefault(path, (dive, report, []))
        if owner is not dive:
            raise ConfigError(f"{gates.where(gate)}: several dives share {path}", f"use {LOG} for the dive's name")
        if sharing and type(sharing[0]) is not type(gate):
            text = f"{gates.where(gate)}: a trajectory and tables share {path}"
            raise ConfigError(text, "use a separate file for the trajectory")
        sharing.append(gate)
    for path, (dive, report, sharing) in written.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        on_cells = [gate for gate in sharing if isinstance(gate, CellGate)]
        with result_file(path, force=True) as file:
            if on_cells:
                file.write_bytes(as_json(_gated_values(report, on_cells)))
            else:
                file.write_bytes(read_file(dive.folder / TRAJECTORY_FILE))
                with ZipFile(file, "a") as arrays:
                    arrays.writestr(ZipInfo(_SETTINGS_FILE), as_json(_gated_values(report, [])))
    return list(written)


def _gated_values(report: StoredReport, gates: Sequence[CellGate]) -> dict[str, Any]:
    """Return the gated values with their names, what a comparison needs, and the settings, readable in a review."""
    tables: dict[str, dict[tuple[str, ...], Row]] = {}
    for gate in gates:
        for pair in gate.rows_of(None, report):
            kept = tables.setdefault(gate.table, {}).setdefault((pair.filter, pair.row, pair.unit), {})
            needed = ("log", "filter", pair.layout.key, "unit", "dof", "evidence", gate.column)
            kept.update({column: pair.new[column] for column in needed if column in pair.new})
    candidates = tables.pop(CANDIDATES.name, {}).values()
    return {
        "tool": {name: report.tool[name] for name in ("name", "version") if name in report.tool},
        "log": {"name": report.log.name, "sha256": report.log.sha256},
        "tables": {name: list(rows.values()) for name, rows in tables.items()},
        "baseline": report.baseline,
        "filters": {str(row["filter"]): row for row in candidates},
        "config": _own_settings(report),
    }


def _own_settings(report: StoredReport) -> dict[str, Any]:
    """Return the settings that are not defaults, by dotted key, and the names of the filters."""
    settings = dict(flattened(report.config))
    names = settings.pop(_FILTERS, ", ".join([report.baseline, *report.filters]))
    own = {key: value for key, value in settings.items() if value != _defaults().get(key)}
    return {_FILTERS: names} | own if report.config else {}


@cache
def _defaults() -> dict[str, Any]:
    return dict(flattened(msgspec.to_builtins(Config())))
