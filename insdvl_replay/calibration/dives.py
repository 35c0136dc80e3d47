"""Dives made ready for a calibration: read, prepared, and with their axes tried where nobody knows them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.fit import fit, robust_cost
from insdvl_replay.calibration.innovations import DiveInnovations, dive_innovations
from insdvl_replay.calibration.noise import FittedNoise, nis_per_dof
from insdvl_replay.calibration.parameters import NAMES, PARAMETERS, DvlGeometry, moved_mounting, moved_pings
from insdvl_replay.calibration.rows import HeldOutRow
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats, ReferenceColumns
from insdvl_replay.core.runtime import track_progress
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.outage_test import outage_test_table
from insdvl_replay.geometry.frames import look_down
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.preparation.prepared import Prepared, with_reference_at_imu
from insdvl_replay.preparation.reading import read_checked_dive
from insdvl_replay.preparation.running import coasting_of, coasting_plan, prepared_timeline, run_filters
from insdvl_replay.preparation.start_heading import FIT, prepare_with_heading

AXES: Final[tuple[Floats, ...]] = tuple(
    turn
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    for turn in [np.diag(signs)[:, order]]
    if np.linalg.det(turn) > 0.0
)
"""The 24 ways in which right-handed axes can lie along others."""
CLEARLY: Final = 0.8
"""Share of what one mounting leaves of the innovations, below which another one is the likelier."""
NOT_FAR_OFF: Final = 4.0
"""Times the least that a mounting leaves, beyond which no arm or delay makes it the best."""
MOST_FITTED: Final = 6
COASTED_S: Final = "60"
_ARM_AND_DELAY: Final = np.array([parameter.group in ("arm", "delay") for parameter in PARAMETERS])


@dataclass(frozen=True)
class ReadDive:
    """A dive with its configuration, from which it can be prepared for any geometry.

    Attributes
    ----------
    as_read : ReferenceColumns, optional
        Its reference, before it was moved to the IMU.
    """

    dive: Dive
    config: Config
    as_read: ReferenceColumns | None = None

    def prepared(self, geometry: DvlGeometry | None = None) -> Prepared:
        """Prepare it, with another mounting, arm and scale than configured; its pings keep their times."""
        config = self.config if geometry is None else with_geometry(self.config, geometry)
        return prepare_with_heading(self.dive, config)

    def innovations(self) -> DiveInnovations:
        """Get it ready to be asked."""
        return dive_innovations(self.dive, self.prepared())

    def with_config(self, config: Config) -> "ReadDive":
        """Take other settings for the same readings."""
        return replace(self, config=config)


def read_dive(path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False) -> ReadDive:
    """Read a dive and check it.

    Raises
    ------
    LogError, ConfigError
        As of `reading.read_checked_dive`.
    """
    dive = read_checked_dive(path, config.without_solutions(), allow_damaged=allow_damaged)
    return ReadDive(with_reference_at_imu(dive, config), config, dive.reference)


def with_geometry(config: Config, geometry: DvlGeometry) -> Config:
    """Set what was calibrated in a configuration."""
    dvl = msgspec.structs.replace(
        config.dvl,
        latency_s=geometry.latency_s,
        lever_arm_m=geometry.lever_arm_m,
        mounting_rpy_deg=geometry.mounting_rpy_deg,
        scale=geometry.scale,
    )
    return msgspec.structs.replace(config, dvl=dvl)


@dataclass(frozen=True)
class TriedMounting:
    """One way in which the DVL's axes could lie along the body's, and the robust sum of squares that it leaves.

    That of several likely ones is with the arm and the delay that fit each best.
    """

    rpy_deg: tuple[float, float, float]
    cost: float


def possible_axes(dvl: DvlColumns) -> tuple[Floats, ...]:
    """Leave out the ways with which the beams would not look down, where the messages tell where they look."""
    if dvl.look_d is None:
        return AXES
    return tuple(turn for turn in AXES if look_down(turn @ dvl.look_d)) or AXES


def tried_mountings(dives: Sequence[ReadDive]) -> list[TriedMounting]:
    """Try the ways in which the DVL's axes can lie along the body's, the likeliest first.

    An arm or a delay that is not known yet can make another one look better, so that those that are not far off, and
    what is configured, are tried with arm and delay fitted; these stand before all others.
    """
    configured = dives[0].config.dvl.mounting_rpy_deg
    possible = track_progress("trying mountings", possible_axes(dives[0].dive.dvl))
    first = sorted((_tried(dives, turn) for turn in possible), key=lambda one: one.cost)
    near = [one for one in first if one.cost < NOT_FAR_OFF * first[0].cost][:MOST_FITTED]
    near += [one for one in first if one.rpy_deg == configured and one not in near]
    fitted = [_fitted(dives, one) for one in track_progress("trying mountings with arm and delay", near)]
    return sorted(fitted, key=lambda one: one.cost) + [one for one in first if one not in near]


def _tried(dives: Sequence[ReadDive], turn: Floats) -> TriedMounting:
    rpy_deg = _rpy_deg(turn)
    found = [dive.residuals(np.zeros(len(NAMES))) for dive in _with_mounting(dives, rpy_deg)]
    return TriedMounting(rpy_deg, sum(map(robust_cost, found)))


def _fitted(dives: Sequence[ReadDive], tried: TriedMounting) -> TriedMounting:
    asked = _with_mounting(dives, tried.rpy_deg)
    found = fit(asked, _ARM_AND_DELAY)
    left = [dive.residuals(found.of_dive(i)) for i, dive in enumerate(asked)]
    return TriedMounting(tried.rpy_deg, sum(map(robust_cost, left)))


def _with_mounting(dives: Sequence[ReadDive], rpy_deg: tuple[float, float, float]) -> list[DiveInnovations]:
    config = with_any_heading(with_mounting(dives[0].config, rpy_deg))
    return [dive.with_config(config).innovations() for dive in dives]


def likeliest_mounting(dives: Sequence[ReadDive]) -> tuple[float, float, float]:
    """Return the best of the ways in which the DVL's axes can lie along the body's, as roll, pitch, heading.

    Of several that leave about as much it is one with which the DVL's z looks down, as makers have it: a dive without
    roll and pitch does not tell it from the other side up.
    """
    tried = tried_mountings(dives)
    alike = [one for one in tried if one.cost * CLEARLY <= tried[0].cost]
    return next((one for one in alike if _looks_down(one.rpy_deg)), tried[0]).rpy_deg


def _looks_down(rpy_deg: tuple[float, float, float]) -> bool:
    return bool(mat_from_rpy(np.array(rpy_deg) * DEG)[2, 2] > 0.5)


def _rpy_deg(turn: Floats) -> tuple[float, float, float]:
    roll, pitch, heading = (rpy_from_mat(turn) / DEG + 0.0).tolist()  # no -0.0, which people would read
    return roll, pitch, heading


def with_any_heading(config: Config) -> Config:
    """Start north where the heading is to be fitted: innovations of velocities hardly depend on it, and with a wrong
    mounting no heading fits.
    """
    if config.initial.heading_deg != FIT:
        return config
    return msgspec.structs.replace(config, initial=msgspec.structs.replace(config.initial, heading_deg=0.0))


def with_mounting(config: Config, rpy_deg: tuple[float, float, float]) -> Config:
    """Set the mounting in a configuration."""
    return msgspec.structs.replace(config, dvl=msgspec.structs.replace(config.dvl, mounting_rpy_deg=rpy_deg))


def held_out_row(read: ReadDive, change: Floats, noise: FittedNoise | None = None) -> HeldOutRow:
    """Say how a dive that was not fitted fares before and after a change, shape (8,), and with another noise, too."""
    asked = read.innovations()
    before, after = (_nis_per_dof(asked, of) for of in (np.zeros(len(NAMES)), change))
    windows, drift_before_m = _coasted(read, np.zeros(len(NAMES)))
    _, drift_after_m = _coasted(read, change)
    noisy = None if noise is None else nis_per_dof(noise.applied(asked), change)
    return HeldOutRow(asked.name, before, after, windows, drift_before_m, drift_after_m, noisy)


def _nis_per_dof(asked: DiveInnovations, change: Floats) -> float:
    return float(np.mean(asked.history(change).innovations[0].nis)) / 3.0


def _coasted(read: ReadDive, change: Floats) -> tuple[int, float | None]:
    """Let the baseline coast, and return in how many windows and how far in their median."""
    config = msgspec.structs.replace(
        read.config, filters={read.config.baseline: read.config.filters[read.config.baseline]}
    )
    prepared = prepare_with_heading(read.dive, config)
    start_ns, end_ns = prepared.alignment.start_ns, prepared.end_ns
    moved = replace(
        prepared,
        velocities=moved_pings(prepared.velocities, change).within(start_ns, end_ns),
        mounting=moved_mounting(prepared.mounting, change),
    )
    plan, timeline = coasting_plan(moved), prepared_timeline(read.dive, moved)
    histories = run_filters(moved, timeline, cov_ns=plan.start_ns)
    coasts = coasting_of(read.dive, config, moved, timeline, histories, plan)
    rows = outage_test_table(read.dive.name, coasts)
    found = next((row for row in rows if row.window_s == COASTED_S), None)
    return (0, None) if found is None else (found.windows, found.drift_median_m)
