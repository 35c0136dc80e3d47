"""A report made of few rows, for tests of what shows reports."""

import hashlib

import pandas as pd
from msgspec.structs import replace

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, ImuColumns
from insdvl_replay.core.dive_record import Channel
from insdvl_replay.core.errors import Note
from insdvl_replay.core.report import Report, build_report
from insdvl_replay.core.states import NINE, STATES
from insdvl_replay.core.tables import (
    CandidateVerdict,
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    DriftRow,
    EvidenceRow,
    ImprovementRow,
    JumpRow,
    OutageRow,
    ReferenceErrorRow,
    Tables,
    TrackFitRow,
)
from insdvl_replay.evaluation.convergence import mean_over_nine

NAN = float("nan")


def tables() -> Tables:
    improvement = [
        (
            "dive",
            "aided",
            state.id,
            state.unit,
            1.0,
            0.8,
            20.0 if state in NINE[:3] else NAN,
            "improved",
        )
        for state in STATES
    ]
    convergence = [
        ("dive", "aided", state.id, state.unit, 0.1 + 0.2, 424.0, NAN, NAN, "never")
        for state in STATES[:-1]
    ] + [("dive", "aided", "bg_z", "deg/h", 9.0, 424.0, 106.0, 75.0, "reached")]
    reference = [
        ("dive", "aided", "position_h", "m", 1.25, 1.5, -20.0, 2.0, 2.5, 424, "compared"),
        ("dive", "aided", "position_h_pct", "%", 0.125, 0.15, -20.0, 0.2, 0.25, 424, "compared"),
        ("dive", "aided", "heading", "deg", NAN, NAN, NAN, NAN, NAN, 0, "not in reference"),
    ]
    consistency = [
        (
            "dive",
            "baseline",
            "velocity",
            3,
            424,
            0,
            3.01,
            2.77,
            3.24,
            "consistent",
            -0.05,
            0.095,
            "white",
        ),
        (
            "dive",
            "aided",
            "velocity",
            3,
            424,
            0,
            3.01,
            2.77,
            3.24,
            "consistent",
            0.3,
            0.095,
            "correlated",
        ),
        (
            "dive",
            "aided",
            "acceleration",
            3,
            420,
            2,
            5.0,
            2.77,
            3.24,
            "overconfident",
            NAN,
            NAN,
            "not finite",
        ),
        (
            "dive",
            "aided",
            "acceleration_x",
            1,
            420,
            2,
            12.0,
            0.9,
            1.1,
            "overconfident",
            0.1,
            0.095,
            "white",
        ),
    ]
    credibility = [
        ("dive", "aided", "velocity_n", 1, 424, 1.1, 0.87, 1.14, 66.0, 99.5, "consistent", 400.1),
        ("dive", "aided", "heading", 1, 0, NAN, NAN, NAN, NAN, NAN, "not in reference", NAN),
        ("dive", "aided", "ba_x", 1, 424, 5.0, 0.01, 4.9, 10.0, 90.0, "overconfident", 1.2),
        ("dive", "aided", "all", 5, 424, 9.0, 3.9, 6.1, 30.0, 97.0, "overconfident", 40.0),
    ]
    evidence = [
        ("track", "position", "m", 1.25, 1.5, 1.2, 0.5, 0.4, 0.01, 424, 1, NAN, "primary"),
        ("accuracy", "drift_30s", "m", 1.0, 0.8, 0.8, 0.3, 0.31, 0.05, 74, 1, NAN, "shown"),
        ("accuracy", "level", "deg", 0.05, 0.04, 0.8, 0.02, 0.4, 0.0, 300, 1, 124.0, "secondary"),
        (
            "convergence",
            "convergence_level",
            "s",
            NAN,
            NAN,
            NAN,
            NAN,
            NAN,
            NAN,
            15,
            15,
            NAN,
            "settling",
        ),
        ("consistency", "nis", "", 1.5, 1.0, 0.66, NAN, NAN, NAN, 0, 1, NAN, "shown"),
    ]
    outage = [
        ("dive", "baseline", "30", 9, 0, 0.5, 0.6, 1.1, 2.0, 0.04, 0.1, NAN, NAN, 1.1),
        ("dive", "aided", "30", 9, 0, 0.4, 0.5, 0.9, 1.5, 0.03, 0.1, 0.8, 66.7, 1.0),
    ]
    drift = [
        ("baseline", "position_h", "m", 424, 1.0, 2.0, 1.25, 2.5, 400.0, 400.0, 2.0, 1000.0, 0.2),
        ("aided", "position_h", "m", 424, 1.1, 2.2, 1.5, 2.75, 400.0, 400.0, 2.5, 1000.0, 0.25),
        ("aided", "drift_60s", "m", 60, 0.2, 0.4, 0.3, 0.5, 155.2, 215.2),
    ]
    track_fit = [
        ("baseline", "scale", "%", 0.1834, 0.0213),
        ("baseline", "turn", "deg", -0.3111, 0.0049),
        ("aided", "scale", "%", 0.18, NAN),
        ("aided", "turn", "deg", -0.31, NAN),
    ]
    return Tables(
        [ImprovementRow(*row) for row in improvement],
        [ConvergenceRow(*row) for row in convergence],
        [ReferenceErrorRow(*row) for row in reference],
        [ConsistencyRow(*row) for row in consistency],
        [CredibilityRow(*row) for row in credibility],
        [EvidenceRow("dive", "aided", *row) for row in evidence],
        [OutageRow(*row) for row in outage],
        [DriftRow("dive", *row) for row in drift],
        [TrackFitRow("dive", *row) for row in track_fit],
        [JumpRow("dive", "aided", 2119, 2, 1.31, 207.4)],
    )


def report(name: str = "dive", used: Tables | None = None) -> Report:
    nothing = pd.array([], dtype="int64").to_numpy()
    dive = Dive(
        name,
        ImuColumns(nothing, nothing, nothing),
        DvlColumns(nothing),
        sha256=hashlib.sha256(name.encode()).hexdigest(),
        channels=(Channel("/imu", "sensor_msgs/msg/Imu", "cdr", "imu", 42400),),
    )
    notes = [Note("imu_gaps", "the IMU pauses 3 times", 3, "warning", "imu.max_gap_s")]
    used = used or tables()
    aided = CandidateVerdict(
        "aided predicts smaller sigma",
        "undecided",
        "consistent",
        mean_over_nine(used.improvement, "aided"),
        mean_over_nine(used.convergence, "aided"),
        float("nan"),
        "overconfident",
        "not confirmed",
        primary="position",
    )
    return build_report(
        dive, Config(), used, {"aided": aided}, notes, 1_000_000_000, 425_000_000_000
    )


def unreferenced(used: Tables) -> Tables:
    """Tables of the same dive, had it no reference."""
    return replace(
        used,
        reference_error=[
            replace(row, samples=0, baseline_rmse=None, rmse=None, status="no reference")
            for row in used.reference_error
        ],
        credibility=[replace(row, samples=0, verdict="no reference") for row in used.credibility],
        evidence=[row for row in used.evidence if row.evidence in ("outage", "consistency")],
        drift=[],
        track_fit=[],
    )
