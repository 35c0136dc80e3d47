"""What commands decide: words, statuses, codes, counts, numbers, settings and exit codes, without any sentence."""

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from in_process import done_here

# Keys of results with sentences, or with what depends on them or on the clock.
PROSE: Final = frozenset(
    (
        "text",
        "hint",
        "why",
        "sentences",
        "warnings",
        "sentence",
        "reason",
        "reasons",
        "causes",
        "message",
        "title",
        "elapsed_s",
        "cpu_s",
        "started_at",
        "files",
        "configuration",
    )
)
GATES: Final = """
dives = ["before/good"]
[[gate]]
name = "passes"
table = "filters"
column = "verdict"
equals = ["undecided", "no effect", "not evaluated"]
[[gate]]
name = "fails"
table = "reference_error"
column = "rmse"
max = 0.0
[[gate]]
name = "has no row"
table = "reference_error"
filter = "another"
column = "rmse"
max = 0.0
[[gate]]
name = "has no expected values"
table = "trajectory"
expected = "expected/{log}.npz"
"""
"""Gates of each outcome."""

_NOISE: Final = "--preset fog --set dvl.beam_sd_mps=0.0043"
_RUN: Final = f"run good.mcap broken.mcap {_NOISE} --starts 1 --jobs 1"
_SEARCH: Final = f"run turned.mcap -o found {_NOISE} --starts 1"
COMMANDS: Final = {
    "two logs, one of which is none": f"{_RUN} -o before --format json",
    "another setting": f"run good.mcap -o after {_NOISE} --starts 1 --set dvl.scale=1.05",
    "a noise that is far off": "run good.mcap -o far_off --preset fog --starts 1",
    "a result in the way": "run good.mcap -o before --preset mems --starts 1",
    "comparison": "compare before after --format json --fail-on worse",
    "comparison of values": "compare before after --format json --fail-on 1%",
    "check": "check gates.toml --format json",
    "expected values": "check gates.toml --update --format json",
    "check against expected values": "check gates.toml --format json",
    "look at a log": "inspect turned.mcap --format json",
    "no log": "run absent.mcap -o absent",
    "an unknown key": "run good.mcap -o wrong --set dvl.scael=1.0",
    "an unknown option": "run good.mcap --starst 1",
}
SLOW_COMMANDS: Final = {
    "a search for settings": f"{_SEARCH} --format json",
    "the same again": _SEARCH,
    "one change against another": f"{_RUN} -o against --against dvl.scale=1.05 --format json",
    "look at a whole log": "inspect turned.mcap --deep --format json",
    "look at a table": "inspect table.csv --format json",
    "settings for a log": "inspect turned.mcap --propose proposed.toml",
    "calibration": "calibrate good.mcap --preset fog -o built_in.toml --format json",
}


def decisions(folder: Path, commands: Mapping[str, str]) -> dict[str, Any]:
    """Run commands on the logs in a folder; return what each decides, by its name, and what is in the files."""
    (folder / "gates.toml").write_text(GATES)
    found: dict[str, Any] = {}
    for name, command in commands.items():
        before = _times_of_reports(folder)
        done = done_here(*command.split(), cwd=folder)
        after = _times_of_reports(folder)
        kept = [report for report, time_ns in before.items() if after.get(report) == time_ns]
        found[name] = {"exit code": done.returncode, "results that were kept": kept}
        if done.stdout.startswith("{"):
            found[name]["printed"] = without_prose(json.loads(done.stdout))
    for report in sorted(folder.rglob("report.json")):
        found[str(report.relative_to(folder))] = without_prose(json.loads(report.read_text()))
    for settings in sorted(folder.rglob("*.toml")):
        found[str(settings.relative_to(folder))] = tomllib.loads(settings.read_text())
    return found


def _times_of_reports(folder: Path) -> dict[str, int]:
    """Return when each result was written, ns."""
    reports = sorted(folder.rglob("report.json"))
    return {str(report.relative_to(folder)): report.stat().st_mtime_ns for report in reports}


def without_prose(value: Any) -> Any:
    """Return a part of a JSON file without its sentences; what is missing stays as it is."""
    if isinstance(value, dict):
        return {key: without_prose(inner) for key, inner in value.items() if key not in PROSE}
    if isinstance(value, list):
        return [without_prose(inner) for inner in value]
    return value
