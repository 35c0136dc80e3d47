"""What could these dives have shown? The baseline with planted faults of known size, against the baseline itself.

A trial that finds two treatments equivalent proves nothing unless a control that differs is seen to differ. So each
dive is replayed once more for each control, and its errors are paired with those of the baseline.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import msgspec

from insdvl_replay.core.config import Config, Dvl
from insdvl_replay.core.dive_columns import NS_PER_S, Dive
from insdvl_replay.core.runtime import report_stage
from insdvl_replay.core.tables import AssayRow, Tables, finite
from insdvl_replay.core.words import ReferenceStatus, Role
from insdvl_replay.evaluation.evidence import role_alone
from insdvl_replay.preparation.replay import Replay, replay_dive

Control = Callable[[Dive, Config], tuple[Dive, Config]]
Vector = tuple[float, float, float]


DELAY_S: Final = 0.05


def _dvl(**changes: Callable[[Dvl], Any]) -> Control:
    """Return a control that changes settings of the DVL, each by a function of what they were."""

    def control(dive: Dive, config: Config) -> tuple[Dive, Config]:
        values = {key: change(config.dvl) for key, change in changes.items()}
        dvl = msgspec.structs.replace(config.dvl, **values)
        return dive, msgspec.structs.replace(config, dvl=dvl)

    return control


def _dvl_delay(dive: Dive, config: Config) -> tuple[Dive, Config]:
    """Let each ping count as earlier than it was. The latency of the settings is in the times of a dive already."""
    earlier_ns = dive.dvl.time_ns - round(DELAY_S * NS_PER_S)
    return replace(dive, dvl=replace(dive.dvl, time_ns=earlier_ns)), config


def _dvl_noise(dive: Dive, config: Config) -> tuple[Dive, Config]:
    """Double the noise of the DVL, in whichever key it is."""
    name, baseline = next(iter(config.filters.items()))
    for section in (baseline, config.dvl):
        for key in ("beam_sd_mps", "velocity_sd_mps"):
            sd_mps = getattr(section, key)
            if sd_mps is not None:
                return dive, _with_baseline(config, name, **{key: 2.0 * sd_mps})
    return dive, config


def _gyro_noise(dive: Dive, config: Config) -> tuple[Dive, Config]:
    name, baseline = next(iter(config.filters.items()))
    own = baseline.gyro_white_rad_rts
    white = config.noise.gyro_white_rad_rts if own is None else own
    return dive, _with_baseline(config, name, gyro_white_rad_rts=3.0 * white)


def _with_baseline(config: Config, name: str, **values: float) -> Config:
    changed = msgspec.structs.replace(config.filters[name], **values)
    return msgspec.structs.replace(config, filters={**config.filters, name: changed})


def _moved_arm(dvl: Dvl) -> Vector:
    forward_m, starboard_m, down_m = dvl.lever_arm_m
    return forward_m + 0.05, starboard_m, down_m


def _turned(dvl: Dvl) -> Vector:
    roll_deg, pitch_deg, yaw_deg = dvl.mounting_rpy_deg
    return roll_deg, pitch_deg, yaw_deg + 0.5


CONTROLS: Final[Mapping[str, Control]] = MappingProxyType(
    {
        "dvl_noise_x2": _dvl_noise,
        "gyro_noise_x3": _gyro_noise,
        "lever_arm_5cm": _dvl(lever_arm_m=_moved_arm),
        "delay_50ms": _dvl_delay,
        "heading_half_deg": _dvl(mounting_rpy_deg=_turned),
        "dvl_scale_half_pct": _dvl(scale=lambda dvl: dvl.scale * 1.005),
    }
)
"""By name: how each control changes the dive or the settings. The heading is that of the DVL in the vehicle."""


def assay_of(dive: Dive, config: Config) -> list[AssayRow]:
    """Return what each control does to the errors of the baseline on one dive.

    Parameters
    ----------
    dive : Dive
        As it was read and checked.
    config : Config
        Of its replay; the baseline is run alone, from the dive's own start.
    """
    alone = {config.baseline: config.filters[config.baseline]}
    evaluation = msgspec.structs.replace(config.evaluation, starts=1, candidate="")
    config = msgspec.structs.replace(config, filters=alone, evaluation=evaluation)
    is_independent = config.reference.independent
    before = _errors(replay_dive(dive, config), independent=is_independent)
    rows = []
    for name, control in CONTROLS.items():
        report_stage(f"assay: {name}")
        faulty = replay_dive(*control(dive, config))
        after = _errors(faulty, independent=is_independent)
        for quantity, (unit, value, role) in before.items():
            if quantity in after:
                new = after[quantity][1]
                ratio = new / value if value > 0.0 else None
                rows.append(AssayRow(dive.name, name, quantity, unit, value, new, ratio, role))
    return rows


class _Measured(NamedTuple):
    quantity: str
    unit: str
    rms: float
    windows: int = 0  # of an outage


def _errors(replay: Replay, *, independent: bool) -> dict[str, tuple[str, float, Role]]:
    """Return unit, error and role of each quantity of a filter that was replayed alone."""
    found = {}
    delay = replay.dive.reference_delay
    for measured in _measured(replay.tables):
        if measured.rms == measured.rms:
            role = role_alone(
                measured.quantity, measured.windows, independent=independent, delay=delay
            )
            found[measured.quantity] = measured.unit, measured.rms, role
    return found


def _measured(tables: Tables) -> Iterator[_Measured]:
    """Yield what is measured of each quantity."""
    errors = {
        row.quantity: row
        for row in tables.reference_error
        if row.status == ReferenceStatus.COMPARED
    }
    if "position_h" in errors:
        yield _Measured("position", "m", finite(errors["position_h"].rmse))
    for row in tables.outage:
        yield _Measured(f"outage_{row.window_s}s", "m", finite(row.drift_rms_m), row.windows)
    for drift in tables.drift:
        if drift.quantity != "position_h":
            yield _Measured(drift.quantity, drift.unit, finite(drift.rms))
    if "roll" in errors and "pitch" in errors:
        level_sq = 0.5 * (finite(errors["roll"].rmse) ** 2 + finite(errors["pitch"].rmse) ** 2)
        yield _Measured("level", "deg", level_sq**0.5)
    if "heading" in errors:
        yield _Measured("heading", "deg", finite(errors["heading"].rmse))
