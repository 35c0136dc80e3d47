"""Mistakes in gate files, and why a gate is not passed."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from as_text import Cases, refusal, spoken
from small_results import content, write

from insdvl_replay.changes.cell_gates import gate_findings
from insdvl_replay.changes.findings import Finding
from insdvl_replay.changes.gate_file import (
    CellGate,
    TrajectoryGate,
    load_gates,
    require_known_filters,
)
from insdvl_replay.changes.trajectory_gates import trajectory_findings
from insdvl_replay.core.report import StoredReport
from insdvl_replay.core.states import COLUMNS
from insdvl_replay.results.trajectory import Trajectory

GATE = '[[gate]]\nname = "a"\ntable = "improvement"\ncolumn = "sd"\n'
TRAJECTORY = '[[gate]]\nname = "a"\ntable = "trajectory"\n'
FILES = (
    "dives = [",
    f"dvies = []\n{GATE}max = 1",
    f"{GATE}maxx = 1",
    f'{GATE}max = "1"',
    f'{GATE}max = 1\nlevel = "loud"',
    GATE,
    f"{GATE}max_worse_pct = 1\nmax = 1",
    f'{GATE}expected = "b.json"',
    f"{GATE}max = 1\n{GATE}min = 1",
    f'{GATE}max = 1\nlevel = "off"',
    "dives = []\n\n[[gates]]\nmax = 1",
    f"{GATE}min = nan",
    f"{GATE}max = inf",
    f"{GATE}max = 1\nmin = 2",
    f'{GATE}expected = "{{lg}}.json"\nmax_worse_abs = 1',
    "dives = []",
    f"{GATE}equals = true",
    f"{GATE}max = {'9' * 5000}",
    f"{GATE}max = {'[' * 5000}",
    "gate = 3",
    f'{TRAJECTORY}row = "heading"\nexpected = "b.npz"',
    f'{TRAJECTORY}column = "rmse"\nexpected = "b.npz"',
    TRAJECTORY,
    f'{TRAJECTORY}row = "attitude"\nwithin = [0, 1]',
    f'{TRAJECTORY}row = "position_error_m"\nwithin = [1, 0]',
    f'{TRAJECTORY}row = "position_error_m"\nwithin = [0, 1]\nexpected = "b.npz"',
    f'{TRAJECTORY}expected = "b.npz"\nmax_abs = {{ heading = 1 }}',
)
NAMES: tuple[dict[str, Any], ...] = (
    {"table": "improvment"},
    {"row": "ba_zz"},
    {"table": "reference_error", "column": "rmse", "row": "positon_h"},
    {"table": "consistency", "column": "mean_nis", "row": "velocityx"},
    {"table": "filters", "column": "mean_improvement_pct", "row": "aidd"},
    {"filter": "baseline"},
    {"column": "status"},
    {"table": "filters", "column": "reason", "equals": ""},
    {"table": "filters", "column": "sentence", "equals": "x"},
    {"column": "sdd"},
    {"filter": "aidde"},
    {"equals": "improved"},
    {"table": "consistency", "column": "verdict", "equals": 3},
    {"column": "unit", "expected": "b.json", "max_worse_pct": 1},
)
PASSING = '[[gate]]\nname = "sd"\ntable = "improvement"\ncolumn = "sd"\nrow = "ba_x"\nmax = 1.0\n'
EXPECTED = PASSING.replace("max = 1.0", 'expected = "expected/{log}.json"\nmax_worse_pct = 1')


def stored(**changes: Any) -> StoredReport:
    return msgspec.convert(content(**changes), StoredReport)


def gate(**keys: Any) -> CellGate:
    return msgspec.convert({"name": "a", "table": "improvement", "column": "sd"} | keys, CellGate)


def reasons(findings: Iterable[Finding]) -> str:
    return "\n".join(finding.sentence for finding in findings if not finding.passed)


def with_known_filters(file: Path) -> None:
    require_known_filters(load_gates(file), ["baseline", "aided"])


def said_of_gates(folder: Path) -> Cases:
    """Return what is said of files, names, cells, trajectories, and by the command."""
    file = folder / "gates.toml"
    for text in FILES:
        file.write_text(text, "utf-8")
        yield (
            f"in a file: {text.rstrip()}".replace(GATE, "GATE\n").replace("\n", " / "),
            refusal(load_gates, file),
        )
    for keys in NAMES:
        lines = {"name": "b", "table": "improvement", "column": "sd", "max": 1} | keys
        if {"equals", "expected"} & keys.keys():
            del lines["max"]
        text = "".join(
            f"{key} = {msgspec.json.encode(value).decode()}\n" for key, value in lines.items()
        )
        file.write_text(f"[[gate]]\n{text}", "utf-8")
        yield f"a gate of {keys}", refusal(with_known_filters, file)
    yield from of_cells()
    yield from of_trajectories()
    yield from by_the_command(folder)


def of_cells() -> Cases:
    unjudged, lost, empty = stored(filter_verdict="not evaluated"), stored(), stored()
    part, less, without_dof = stored(), stored(), stored()
    part.tables["reference_error"][0]["status"] = "partly covered"
    empty.tables["improvement"][0]["sd"] = None
    lost.tables["improvement"][0]["improvement_pct"] = 44.0
    del less.tables["improvement"][0]
    for row in without_dof.tables["consistency"]:
        del row["dof"]
    both, none = stored(), stored()
    both.filters["other"] = both.filters["aided"]
    none.tables["improvement"].clear()
    errors: dict[str, Any] = {"table": "reference_error", "column": "rmse", "max": 1e9}
    worse: dict[str, Any] = {"expected": "b", "max_worse_pct": 5}
    nis: dict[str, Any] = {"table": "consistency", "column": "mean_nis", **worse}
    mean = {"table": "filters", "column": "mean_improvement_pct", **worse}
    for name, keys, report, baseline in (
        ("too large", {"max": 1.0}, stored(bg_z_sd=1.5), None),
        ("too small", {"min": 1.2, "row": "ba_x"}, stored(), None),
        (
            "another word",
            {"column": "status", "equals": ["same", "worse"], "row": "ba_x"},
            stored(),
            None,
        ),
        ("of a filter that is not evaluated", {"max": 1.0, "row": "ba_x"}, unjudged, None),
        ("of a part of the reference", {**errors, "row": "roll"}, part, None),
        ("empty", {"max": 1.0, "row": "ba_x"}, empty, None),
        ("a row that is not there", {**errors, "row": "rol"}, stored(), None),
        ("a filter that is not there", {"filter": "aidde", "max": 1}, stored(), None),
        ("worse than expected", {"row": "ba_x", **worse}, stored(ba_x_sd=1.2), stored()),
        (
            "worse percentage",
            {"row": "ba_x", "column": "improvement_pct", **worse},
            lost,
            stored(),
        ),
        ("without degrees of freedom", nis, without_dof, stored()),
        ("no number is expected", {"row": "ba_x", **worse}, stored(), none),
        ("an expected row is missing", worse, less, stored()),
        ("an expected filter is missing", mean, stored(), both),
    ):
        yield name, reasons(gate_findings(gate(**keys), report, baseline))  # type: ignore[arg-type]


def made(samples: int = 400) -> Trajectory:
    """A baseline and a candidate at rest."""
    return Trajectory(
        "ab" * 32,
        ("baseline", "aided"),
        np.arange(float(samples)),
        np.zeros((2, samples, len(COLUMNS))),
    )


def changed(column: str, samples: slice, by: float) -> Trajectory:
    values = made().values.copy()
    values[1, samples, COLUMNS.index(column)] += by
    return replace(made(), values=values)


def of_trajectories() -> Cases:
    same = TrajectoryGate(name="a", table="trajectory", expected="{log}.npz")
    one = replace(made(), names=("baseline",), values=made().values[:1])
    outside = changed("position_error_m", slice(100, 120), 50.0)
    for name, new, old in (
        ("a heading that differs", changed("heading_deg", slice(132, 400), 3.1e-4), made()),
        ("a value that is missing", changed("position_error_m", slice(50), np.nan), made()),
        ("a new filter", made(), one),
        ("a filter that is gone", one, made()),
        ("other times", made(399), made()),
        ("no trajectory", None, made()),
    ):
        yield name, reasons(trajectory_findings(same, new, old))
    for keys in (
        {},
        {"share_pct": 99.0},
        {"longest_outside_s": 19.0},
        {"at_s": 100.0},
        {"at_s": 1000.0},
    ):
        names = {"name": "a", "table": "trajectory", "filter": "aided", "row": "position_error_m"}
        row = TrajectoryGate(within=(0.0, 3.5), **names, **keys)  # type: ignore[arg-type]
        yield f"over time {keys}", reasons(trajectory_findings(row, outside, made()))


def by_the_command(folder: Path) -> Cases:
    write(folder / "dive", content())
    write(folder / "second", content("second", ba_x_sd=1.2))
    without_name = content("broken")
    del without_name["tables"]["improvement"][1]["state"]
    write(folder / "broken", without_name)
    write(folder / "hostile" / "result", content("../../x"))
    (folder / "absent").mkdir()
    half = "share_of_dives_pct = 50\n"
    for name, gates, arguments in (
        ("passed", PASSING, ["dive"]),
        ("failed", PASSING, ["dive", "second"]),
        ("a share", PASSING + half, ["dive", "second"]),
        ("a warning", f'{PASSING}level = "warn"\n', ["second"]),
        ("no result", PASSING, ["broken", "dive"]),
        ("no expected values", EXPECTED, ["dive"]),
        ("new expected values", EXPECTED, ["dive", "--update"]),
        ("the same expected values", EXPECTED, ["dive", "--update"]),
        (
            "shared expected values",
            EXPECTED.replace("{log}", "all"),
            ["dive", "second", "--update"],
        ),
        ("a name of no dive", EXPECTED, ["hostile/result", "--update"]),
        ("a name of no file", EXPECTED.replace("{log}", "a" * 5000), ["dive"]),
        ("nothing to update", PASSING, ["dive", "--update"]),
        ("no such gate", PASSING, ["dive", "--only", "ba_y*"]),
        ("no such settings", f'config = "vehicle.toml"\n{PASSING}', ["dive"]),
        ("no dives", PASSING, []),
        ("no such dives", PASSING, ["*.bag"]),
        ("the output is a gate file", PASSING, ["dive", "--output", "gates.toml"]),
        ("the output has no folder", PASSING, ["dive", "--output", "nowhere/gates.xml"]),
    ):
        (folder / "gates.toml").write_text(gates, "utf-8")
        yield f"check: {name}", spoken(folder, "check", "gates.toml", *arguments)
    (folder / "gates.toml").write_text(EXPECTED, "utf-8")
    (folder / "expected" / "dive.json").write_text('{"tool": ')
    yield "check: broken expected values", spoken(folder, "check", "gates.toml", "dive")
