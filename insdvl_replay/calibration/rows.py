"""The tables of a calibration."""

from typing import Annotated, Final

from msgspec import Meta, Struct

from insdvl_replay.core.tables import Number
from insdvl_replay.core.words import Estimated


class ParameterRow(Struct, frozen=True):
    """One parameter: how far it is from the configuration, and how sure that is. SI, or degrees."""

    parameter: str
    unit: str
    change: Annotated[Number, Meta(description="from what the configuration says; null where nothing was asked")] = None
    formal_sd: Number = None
    correlated_sd: Annotated[Number, Meta(description="with the correlation of the innovations")] = None
    between_dives_sd: Annotated[Number, Meta(description="of the mean over dives; null of one dive")] = None
    beams_sd: Annotated[Number, Meta(description="what beams may be off by, each by 0.2 % and 1 mm/s")] = None
    imu_sd: Annotated[Number, Meta(description="what is left of IMU scale, 1500 ppm, and misalignment, 1 mrad")] = None
    sd: Annotated[Number, Meta(description="the largest of the three with beams and IMU, at most the prior's")] = None
    signal_to_noise: Annotated[Number, Meta(description="prior's sd over that of the data")] = None
    birge: Annotated[Number, Meta(description="how much more dives differ than they should; 1 is expected")] = None
    status: Estimated = Estimated.HELD
    why: Annotated[str, Meta(description="the manoeuvre that shows it, or what keeps it as it was")] = ""


class NoiseRow(Struct, frozen=True):
    """White noise of one kind of sensor, by the innovations with the DVL as it was found."""

    parameter: Annotated[str, Meta(description="key of [noise] or [dvl]")]
    unit: str
    before: Annotated[float, Meta(description="what the configuration says")]
    after: Annotated[float, Meta(description="what is proposed; what is held and doubtful stays as before")]
    sd: Annotated[Number, Meta(description="of what the innovations show; null where they do not bound it")]
    sensor_class: Annotated[str, Meta(description="best class of inertial sensors that may be so noisy; else empty")]
    status: Estimated
    why: Annotated[str, Meta(description="why it is not proposed, or an upper limit; else empty")]

    @property
    def is_proposed(self) -> bool:
        """Whether it is estimated, or a limit below what is configured."""
        limit = self.status == Estimated.NOT_DETERMINED and self.after != self.before
        return limit or self.status == Estimated.ESTIMATED


class DiveRow(Struct, frozen=True):
    """One dive: its delay, and its innovations before and after, in standard deviations by the fitted noise."""

    dive: str
    pings: int
    left_out: Annotated[int, Meta(description="pings far from their neighbours, which no vehicle could have followed")]
    delay_s: Number
    delay_sd_s: Number
    before_x: Annotated[float, Meta(description="scatter by axis, forward, starboard, down")]
    before_y: float
    before_z: float
    after_x: float
    after_y: float
    after_z: float
    autocorrelation_x: Annotated[float, Meta(description="of neighbours, after")]
    autocorrelation_y: float
    autocorrelation_z: float

    def axes(self, name: str) -> list[float]:
        """Return ``before``, ``after`` or ``autocorrelation`` of the three axes."""
        return [getattr(self, f"{name}_{axis}") for axis in "xyz"]


class HeldOutRow(Struct, frozen=True):
    """One dive that was not fitted: its innovations, and how far it drifts, before and after."""

    dive: str
    nis_per_dof_before: Number
    nis_per_dof_after: Number
    windows: Annotated[int, Meta(description="of 60 s without velocities")]
    drift_before_m: Annotated[Number, Meta(description="median over them")]
    drift_after_m: Number
    nis_per_dof_noise: Annotated[
        Number, Meta(description="after, with the noise that is proposed, too; null without")
    ] = None


class ReferenceDiveRow(Struct, frozen=True):
    """One dive beside its reference, before and after: what is left, and how the tracks fit."""

    dive: str
    rows: Annotated[int, Meta(description="of the reference that were compared")]
    unit: Annotated[str, Meta(description="m/s of velocities; m of ways, where the reference has none")]
    rms_before: Annotated[float, Meta(description="of velocities in axes of the body, or of ways of 10 s")]
    rms_after: float
    track_scale_before_pct: Annotated[Number, Meta(description="positive where the filter's track is too short")]
    track_scale_after_pct: Number
    track_scale_sd_pct: Number
    track_turn_before_deg: Annotated[Number, Meta(description="clockwise, the filter's own heading error included")]
    track_turn_after_deg: Number
    track_turn_sd_deg: Number


class StartRow(Struct, frozen=True):
    """One dive whose reference has positions alone: its heading at the start, and the bias of the gyro about down."""

    dive: str
    heading_deg: float
    heading_sd_deg: float
    gyro_bias_degph: float
    gyro_bias_sd_degph: float


TABLES: Final[dict[str, type[Struct]]] = {
    "parameters": ParameterRow,
    "noise": NoiseRow,
    "dives": DiveRow,
    "held_out": HeldOutRow,
    "reference": ReferenceDiveRow,
    "starts": StartRow,
}
