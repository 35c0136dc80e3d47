"""Small stored results, for tests of what reads them."""

import json
from pathlib import Path
from typing import Any

STATES = {"ba_x": "mg", "bg_z": "deg/h"}


def content(name: str = "dive", **changes: Any) -> dict[str, Any]:
    """A report.json of one candidate with two states, a quantity and a measurement.

    `changes` go to the cells of their name: ``sd``, ``rmse``, ``final``, ``mean_nis``, ``reached_s``, ``verdict``,
    ``filter``, ``sha256``, ``window``, ``filter_verdict``, ``reason`` and ``prediction``; ``ba_x_sd`` goes to one row
    alone.
    """
    filter_ = changes.get("filter", "aided")
    row = {"log": name, "filter": filter_}
    improvement = [
        {**row, "state": state, "unit": unit, "baseline_sd": 2.0, "sd": changes.get(f"{state}_sd", 1.0),
         "improvement_pct": 50.0, "status": "improved"}
        for state, unit in STATES.items()
    ]  # fmt: skip
    convergence = [
        {**row, "state": state, "unit": unit, "target_sd": 2.0, "baseline_s": 100.0,
         "reached_s": changes.get("reached_s", 40.0), "improvement_pct": 60.0, "status": "reached"}
        for state, unit in STATES.items()
    ]  # fmt: skip
    errors = [
        {**row, "quantity": "roll", "unit": "deg", "baseline_rmse": 0.5, "rmse": changes.get("rmse", 0.4),
         "improvement_pct": 20.0, "baseline_final": -0.1, "final": changes.get("final", -0.2), "samples": 300,
         "status": "compared"}
    ]  # fmt: skip
    verdict = changes.get("verdict", "consistent")
    consistency = [
        {**row, "measurement": "velocity", "dof": 3, "used": 300, "rejected": changes.get("rejected", 0),
         "mean_nis": changes.get("mean_nis", 3.1), "low": 2.7, "high": 3.3, "verdict": verdict}
    ]  # fmt: skip
    evidence = [
        {**row, "evidence": "track", "quantity": "position", "unit": "m", "baseline": 1.0, "value": 0.8, "ratio": 0.8,
         "moves": 0.5, "acts": 0.5, "reference_noise": 0.01, "samples": 300, "starts": 1, "from_s": None,
         "role": "primary"}
    ]  # fmt: skip
    return {
        "tool": {"name": "insdvl-replay", "version": "0.1.0", "started_at": "2026-01-01T00:00:00+00:00"},
        "versions": {"numpy": "2.4.0"},
        "log": {"name": name, "sha256": changes.get("sha256", f"hash of {name}"), "start_ns": 0, "end_ns": 10**9,
                "duration_s": 1.0, "channels": [{"topic": "/imu", "type_name": "sensor_msgs/msg/Imu",
                "encoding": "cdr", "role": "imu", "messages": 100}]},
        "baseline": "baseline",
        "filters": {filter_: {"sentence": "a sentence", "verdict": changes.get("filter_verdict", "better"),
                              "reason": changes.get("reason", ""), "primary": "position",
                              "prediction": changes.get("prediction", "confirmed"),
                              "consistency": verdict, "mean_improvement_pct": 50.0,
                              "mean_convergence_improvement_pct": 60.0, "reference_improvement_pct": 20.0}},
        "tables": {"improvement": improvement, "convergence": convergence, "reference_error": errors,
                   "consistency": consistency, "evidence": evidence},
        "notes": [],
        "config": {"dvl": {"scale": 1.0}, "filters": {filter_: {"window": changes.get("window", 3)}}},
    }  # fmt: skip


def nudged(report: dict[str, Any], share: float) -> dict[str, Any]:
    """The same report with every number of its tables larger by a share; counts are left alone."""
    rows = [
        *report["filters"].values(),
        *(row for table in report["tables"].values() for row in table),
    ]
    for row in rows:
        row |= {
            key: value * (1.0 + share) for key, value in row.items() if isinstance(value, float)
        }
    return report


def write(folder: Path, report: dict[str, Any]) -> Path:
    """Write a report where a result folder has it, and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(report), "utf-8")
    return folder
