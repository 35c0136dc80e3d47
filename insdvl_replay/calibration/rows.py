"""The tables of a calibration."""

import math
from typing import Annotated, ClassVar, Final

from msgspec import Meta, Struct

from insdvl_replay.core.tables import Col, Number
from insdvl_replay.core.words import Estimated


class ParameterRow(Struct, frozen=True):
    """One parameter: its change from the configuration and its standard deviations. SI, or degrees."""

    parameter: str
    unit: str
    change: Annotated[
        Number, Meta(description="change from the configuration; null if not requested")
    ] = None
    formal_sd: Number = None
    correlated_sd: Annotated[
        Number, Meta(description="allows for the correlation of the innovations")
    ] = None
    between_dives_sd: Annotated[
        Number, Meta(description="of the mean over dives; null for one dive")
    ] = None
    beams_sd: Annotated[
        Number, Meta(description="from errors of each beam of 0.2 % and 1 mm/s")
    ] = None
    imu_sd: Annotated[
        Number, Meta(description="from IMU errors of 1500 ppm scale and 1 mrad misalignment")
    ] = None
    sd: Annotated[
        Number,
        Meta(description="largest of the first three, plus beams and IMU; at most the prior's"),
    ] = None
    signal_to_noise: Annotated[Number, Meta(description="prior's sd over that of the data")] = None
    birge: Annotated[
        Number,
        Meta(
            description="Birge ratio: scatter between dives over the expected one; 1 is expected"
        ),
    ] = None
    status: Estimated = Estimated.HELD
    why: Annotated[
        str, Meta(description="the manoeuvre that determines it, or why it is unchanged")
    ] = ""


class NoiseRow(Struct, frozen=True):
    """White noise of one kind of sensor, estimated from the innovations with the calibrated DVL."""

    parameter: Annotated[str, Meta(description="key of [noise] or [dvl]")]
    unit: str
    before: Annotated[float, Meta(description="configured value")]
    after: Annotated[
        float, Meta(description="proposed value; equal to before if it is held or implausible")
    ]
    sd: Annotated[
        Number, Meta(description="of the estimate; null if the innovations do not bound it")
    ]
    sensor_class: Annotated[
        str, Meta(description="best class of inertial sensors with this noise; else empty")
    ]
    status: Estimated
    why: Annotated[str, Meta(description="why it is not proposed or only a limit; else empty")]

    @property
    def is_proposed(self) -> bool:
        """Whether it is estimated, of a class, or a limit other than configured; never a noise that no sensor has."""
        # heavy, and a schema needs the rows alone
        from insdvl_replay.evaluation.notes import CLASSES

        known = self.status == Estimated.ESTIMATED
        unknown = (
            self.status in (Estimated.NOT_DETERMINED, Estimated.OF_CLASS)
            and self.after != self.before
        )
        is_possible = CLASSES[self.parameter].least <= self.after < math.inf
        return is_possible and (known or unknown)


class DiveRow(Struct, frozen=True):
    """One dive: its delay, and its innovations before and after, in standard deviations of the fitted noise."""

    dive: str
    pings: int
    left_out: Annotated[
        int, Meta(description="outliers: pings too far from the pings around them")
    ]
    delay_s: Number
    delay_sd_s: Number
    before_x: Annotated[float, Meta(description="scatter by axis, forward, starboard, down")]
    before_y: float
    before_z: float
    after_x: float
    after_y: float
    after_z: float
    autocorrelation_x: Annotated[
        float, Meta(description="lag-1 correlation of the innovations, after")
    ]
    autocorrelation_y: float
    autocorrelation_z: float

    def axes(self, name: str) -> list[float]:
        """Return ``before``, ``after`` or ``autocorrelation`` of the three axes."""
        return [getattr(self, f"{name}_{axis}") for axis in "xyz"]


class HeldOutRow(Struct, frozen=True):
    """One held-out dive: its NIS and its drift without DVL, before and after."""

    title: ClassVar = "Dives that were not fitted: NIS / dof, and drift in 60 s without velocities"

    dive: Annotated[str, Col(head="dive")]
    nis_per_dof_before: Annotated[Number, Col(head="NIS before")]
    nis_per_dof_after: Annotated[Number, Col(head="after")]
    windows: Annotated[
        int, Meta(description="number of DVL outage tests of 60 s"), Col(head="windows")
    ]
    drift_before_m: Annotated[
        Number, Meta(description="median over the windows"), Col(head="drift before\n[m]")
    ]
    drift_after_m: Annotated[Number, Col(head="after\n[m]")]
    nis_per_dof_noise: Annotated[
        Number,
        Meta(description="after, also with the proposed noise; null if none"),
        Col(head="NIS with\nnoise"),
    ] = None


class ReferenceDiveRow(Struct, frozen=True):
    """One dive compared with its reference, before and after: remaining differences and track fit."""

    title: ClassVar = (
        "Difference from the reference, before and after: "
        "velocity (or displacement in 10 s), and track fit"
    )
    footnote: ClassVar = (
        "Scale and turn align the filter's track with the reference's. "
        "The turn includes the drift of the heading."
    )

    dive: Annotated[str, Col(head="dive")]
    rows: Annotated[
        int, Meta(description="number of reference rows that were compared"), Col(head="rows")
    ]
    unit: Annotated[
        str,
        Meta(
            description="m/s for velocities; m for displacements, if the reference has no velocity"
        ),
        Col(head="unit"),
    ]
    rms_before: Annotated[
        float,
        Meta(description="rms difference of velocities in body axes, or of displacements in 10 s"),
        Col(head="rms before"),
    ]
    rms_after: Annotated[float, Col(head="after")]
    track_scale_before_pct: Annotated[
        Number,
        Meta(description="positive if the filter's track is too short"),
        Col(head="scale before\n[%]"),
    ]
    track_scale_after_pct: Annotated[Number, Col(head="after\n[%]")]
    track_scale_sd_pct: Number
    track_turn_before_deg: Annotated[
        Number,
        Meta(description="clockwise; includes the filter's heading error"),
        Col(head="turn before\n[deg]"),
    ]
    track_turn_after_deg: Annotated[Number, Col(head="after\n[deg]")]
    track_turn_sd_deg: Number


class StartRow(Struct, frozen=True):
    """One dive whose reference has only positions: heading at the start and gyro bias about down."""

    title: ClassVar = (
        "Headings at the start, from the tracks of positions with the proposed DVL settings"
    )
    footnote: ClassVar = 'initial.heading_deg = "fit" estimates them for each dive.'

    dive: Annotated[str, Col(head="dive")]
    heading_deg: Annotated[float, Col(head="heading\n[deg]")]
    heading_sd_deg: Annotated[float, Col(head="sd")]
    gyro_bias_degph: Annotated[float, Col(head="gyro bias\n[deg/h]")]
    gyro_bias_sd_degph: Annotated[float, Col(head="sd")]


TABLES: Final[dict[str, type[Struct]]] = {
    "parameters": ParameterRow,
    "noise": NoiseRow,
    "dives": DiveRow,
    "held_out": HeldOutRow,
    "reference": ReferenceDiveRow,
    "starts": StartRow,
}
