"""Rows on where a track goes: drift without velocities, against the reference, jumps, and the fit of a whole track.

As in `rows`, of whose tables they are the rest.
"""

from typing import Annotated, ClassVar

from msgspec import Struct

from insdvl_replay.core.quantities import (
    COASTING_WINDOWS_S,
    DRIFT_QUANTITIES,
    TRACK_FIT_QUANTITIES,
)
from insdvl_replay.core.table_layout import Column, Number


class CoastingRow(Struct, frozen=True):
    """How far a filter drifts in some time without velocities, beside the baseline."""

    about: ClassVar = (
        "Windows of one length in which every velocity was withheld from a filter: how far it went astray by what the "
        "withheld velocities say. Where a wrong heading, scale or mounting about down takes the track is "
        "not seen."
    )
    baseline_too: ClassVar = True

    log: Annotated[str, Column("Dive, filter and length of the windows.")]
    filter: str
    window_s: Annotated[str, Column(names=COASTING_WINDOWS_S)]
    windows: Annotated[int, Column("Windows that do not overlap, and those left out since DVL or IMU fell silent.")]
    left_out: int
    drift_median_m: Annotated[
        Number,
        Column(
            "Horizontal drift at the end of a window: median, root mean square and 95th percentile, which of fewer "
            "than 20 windows is nearly the largest.",
            better="lower",
            primary=True,
        ),
    ]
    drift_rms_m: Annotated[Number, Column(better="lower")]
    drift_p95_m: Annotated[Number, Column(better="lower")]
    drift_of_distance_pct: Annotated[
        Number, Column("Median over windows; NaN where the vehicle hardly moved.", better="lower")
    ]
    end_velocity_mps: Annotated[Number, Column("Median horizontal velocity error at the end.", better="lower")]
    vertical_median_m: Annotated[Number, Column("Median vertical drift, either way.", better="lower")]
    ratio_to_baseline: Annotated[
        Number,
        Column(
            "Ratio of the root mean squares over the same windows, with its 95 % interval; NaN for the baseline.",
            better="lower",
        ),
    ]
    ratio_low: Number
    ratio_high: Number
    windows_won_pct: Annotated[
        Number, Column("Windows in which it drifts less than the baseline; a draw counts half.", better="higher")
    ]
    nis_per_dof: Annotated[Number, Column("Mean over windows, of the last withheld velocity; 1 is expected.")]


class DriftRow(Struct, frozen=True):
    """How far one filter is from the reference: half of the time, nearly always, and at worst."""

    about: ClassVar = "One quantity: the errors of a filter against the reference half of the time, mostly, at worst."
    baseline_too: ClassVar = True

    log: Annotated[str, Column("Dive, filter and quantity: the position, its drift over stretches, or the velocity.")]
    filter: str
    quantity: Annotated[str, Column(names=tuple(DRIFT_QUANTITIES))]
    unit: Annotated[str, Column("Unit of the errors.")]
    samples: Annotated[int, Column("Times, or stretches, which overlap, that were compared.")]
    p50: Annotated[
        Number,
        Column(
            "What half and 95 % of the sizes stay below, of the position CEP50 and CEP95; and the root mean square.",
            better="lower",
            primary=True,
        ),
    ]
    p95: Annotated[Number, Column(better="lower")]
    rms: Annotated[Number, Column(better="lower")]
    worst: Annotated[Number, Column("The largest size.", better="lower")]
    worst_from_s: Annotated[Number, Column("Where it begins and ends, from the start; of the others than drift once.")]
    worst_to_s: Number
    final: Annotated[Number, Column("The last size.", better="lower")] = None
    distance_m: Annotated[Number, Column("Distance travelled to the last compared position.")] = None
    final_of_distance_pct: Annotated[
        Number, Column("Of the position: the final error in percent of that distance.", better="lower")
    ] = None


class JumpRow(Struct, frozen=True):
    """How often the position of one filter jumps."""

    about: ClassVar = (
        "A filter whose position can jump: the steps of it that neither its velocity nor the steps around explain."
    )
    baseline_too: ClassVar = True

    log: Annotated[str, Column("Dive and filter: a solution that was read, or one that estimates its position.")]
    filter: str
    steps: Annotated[int, Column("Steps from a horizontal position to the next that were looked at.")]
    jumps: Annotated[
        int,
        Column(
            "Those of which more than 0.5 m, and ten robust standard deviations of what usually is, is unexplained.",
            better="lower",
            primary=True,
        ),
    ]
    largest_m: Annotated[Number, Column("The most of a step that is unexplained.", better="lower")]
    largest_at_s: Annotated[Number, Column("Where that step ends, from the start.")]


class TrackFitRow(Struct, frozen=True):
    """What would lay a filter's track on the reference's."""

    about: ClassVar = "The scale or the turn that would lay a filter's track on the reference's, with standard error."
    baseline_too: ClassVar = True

    log: Annotated[str, Column("Dive, filter, and scale or turn.")]
    filter: str
    quantity: Annotated[str, Column(names=tuple(TRACK_FIT_QUANTITIES))]
    unit: Annotated[str, Column("Unit of the two numbers.")]
    fitted: Annotated[
        Number,
        Column("Scale: positive where its track is too small. Turn: clockwise.", better="nearer zero", primary=True),
    ]
    fitted_sd: Annotated[Number, Column("Standard error by noise, without a heading that drifts; NaN of a short dive.")]
