"""The expected values that gates name: read, compared with a replay, and stored by `check --update`.

They show known causes where a gate fails.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from zipfile import BadZipFile, ZipFile, ZipInfo

import msgspec

from insdvl_replay.changes.cells import changed_settings
from insdvl_replay.changes.findings import Checked
from insdvl_replay.changes.gate_file import LOG, CellGate, Gate, Gates, TrajectoryGate
from insdvl_replay.core.config import Config, flattened
from insdvl_replay.core.errors import ConfigError, UserError, listed, looked_for
from insdvl_replay.core.report import Row, StoredLog, StoredReport, as_json
from insdvl_replay.core.tables import CANDIDATES
from insdvl_replay.core.words import GateLevel
from insdvl_replay.results.folder import TRAJECTORY_FILE, read_file, result_file
from insdvl_replay.results.stored_results import read_results

if TYPE_CHECKING:
    # Trajectories need numpy, and a check of tables alone must not wait for it.
    from insdvl_replay.results.trajectory import Trajectory

MOST_CAUSES: Final = 4  # settings that a failure names
_FILTERS: Final = "filters"  # key of the names of all filters, among the settings
_SETTINGS_FILE: Final = "settings.json"  # in the archive of a trajectory
_HASH_DIGITS: Final = 12


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
    path = expected_path(gates, gate, log.name)
    command = f"`insdvl-replay check {gates.path} --update`"
    with looked_for(path):
        if not path.is_file():
            raise ConfigError(
                f"{path}: there are no expected values yet", f"{command} writes them"
            )
    expected = stored_values(gate, path)
    if expected is None:
        kind = "trajectory" if isinstance(gate, TrajectoryGate) else "result"
        raise ConfigError(f"{path}: is not a readable {kind}", f"{command} writes a new one")
    if (
        expected.log.sha256 if isinstance(expected, StoredReport) else expected.sha256
    ) != log.sha256:
        text = f"{path}: the expected values are of another log than {log.name}"
        raise ConfigError(text, f"{command} writes new ones")
    return expected


def known_causes(gates: Gates, dive: str, report: StoredReport) -> tuple[str, ...]:
    """Say what differs from the replay that gave the expected values: log, version of the tool, settings."""
    stored = _replay_of_expected(gates, dive)
    if stored is None:
        return ()
    causes = list[str]()
    if stored.log.sha256 != report.log.sha256:
        before = stored.log.sha256[:_HASH_DIGITS]
        causes.append(f"the log differs: SHA-256 {before} -> {report.log.sha256[:_HASH_DIGITS]}")
    old_version = stored.tool.get("version")
    new_version = report.tool.get("version")
    if old_version and new_version and old_version != new_version:
        causes.append(f"the version of the tool differs: {old_version} -> {new_version}")
    changes = changed_settings(_own_settings(stored), _own_settings(report), _defaults())
    if stored.config and changes:
        causes.append(f"settings differ: {listed(changes.values(), MOST_CAUSES)}")
    return tuple(causes)


def _replay_of_expected(gates: Gates, dive: str) -> StoredReport | None:
    """Return log, version and settings of the replay that gave the expected values of a dive; None if unknown."""
    for gate in gates.gates:
        if gate.expected is not None and gate.applies_to(dive):
            stored = _stored_settings(gate, expected_path(gates, gate, dive))
            if stored is not None:
                return stored
    return None


def _stored_settings(gate: Gate, path: Path) -> StoredReport | None:
    """Read the settings that are stored with expected values; a file of a trajectory has them in a file of its own."""
    if isinstance(gate, CellGate):
        values = stored_values(gate, path)
        if isinstance(values, StoredReport):
            return values
        return None
    try:
        with ZipFile(BytesIO(read_file(path))) as arrays:
            return msgspec.json.decode(arrays.read(_SETTINGS_FILE), type=StoredReport)
    except (OSError, KeyError, BadZipFile, msgspec.DecodeError):
        return None


def with_expected(
    gates: Gates, dives: Sequence[Checked]
) -> Iterator[tuple[Gate, Checked, StoredReport]]:
    """Yield each gate that has expected values, with each dive that it applies to and its result."""
    for gate in gates.gates:
        if gate.expected is not None and gate.level != GateLevel.OFF:
            for dive in dives:
                if isinstance(dive.result, StoredReport) and gate.applies_to(dive.name):
                    yield gate, dive, dive.result


def require_expected(gates: Gates) -> None:
    """Raise a ConfigError if no gate has expected values."""
    if all(gate.expected is None for gate in gates.gates):
        text = f"{gates.path}: no gate has expected values"
        raise ConfigError(text, 'expected = "expected/{log}.json"')


@dataclass
class _ExpectedFile:
    """A file of expected values: the dive that they are of, and the gates that share it."""

    dive: Checked
    report: StoredReport
    gates: list[Gate] = field(default_factory=list)

    def write(self, file: Path) -> None:
        """Write the gated values, or the trajectory with the settings of its replay."""
        on_cells = [gate for gate in self.gates if isinstance(gate, CellGate)]
        values = as_json(_gated_values(self.report, on_cells))
        if on_cells:
            file.write_bytes(values)
            return
        file.write_bytes(read_file(self.dive.folder / TRAJECTORY_FILE))
        with ZipFile(file, "a") as arrays:
            arrays.writestr(ZipInfo(_SETTINGS_FILE), values)


def write_expected(gates: Gates, dives: Sequence[Checked]) -> list[Path]:
    """Store the gated values and trajectories; return the files."""
    files: dict[Path, _ExpectedFile] = {}
    for gate, dive, report in with_expected(gates, dives):
        path = expected_path(gates, gate, dive.name)
        expected = files.setdefault(path, _ExpectedFile(dive, report))
        if expected.dive is not dive:
            text = f"{gates.where(gate)}: several dives share {path}"
            raise ConfigError(text, f"use {LOG} for the dive's name")
        if expected.gates and type(expected.gates[0]) is not type(gate):
            text = f"{gates.where(gate)}: a trajectory and tables share {path}"
            raise ConfigError(text, "use a separate file for the trajectory")
        expected.gates.append(gate)
    for path, expected in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        with result_file(path, force=True) as file:
            expected.write(file)
    return list(files)


def _gated_values(report: StoredReport, gates: Sequence[CellGate]) -> dict[str, Any]:
    """Return the gated values with their names, what a comparison needs, and the settings, readable in a review."""
    tables: dict[str, dict[tuple[str, ...], Row]] = {}
    for gate in gates:
        for pair in gate.rows_of(None, report):
            rows = tables.setdefault(gate.table, {})
            kept = rows.setdefault((pair.filter, pair.row, pair.unit), {})
            needed = ("log", "filter", pair.layout.key, "unit", "dof", "evidence", gate.column)
            for column in needed:
                if column in pair.new:
                    kept[column] = pair.new[column]
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
    if report.config:
        return {_FILTERS: names} | own
    return {}


@cache
def _defaults() -> dict[str, Any]:
    return dict(flattened(msgspec.to_builtins(Config())))
