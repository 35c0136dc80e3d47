"""A calibration of dives that were read: some are fitted; those that are held out say whether the estimates help."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import msgspec
import numpy as np

from insdvl_replay.calibration.calibration import OUTAGES_S, Calibration, calibrate, held_out_row
from insdvl_replay.calibration.division import Division
from insdvl_replay.calibration.fit import likeliest_mounting, possible_axes, with_mounting
from insdvl_replay.calibration.innovations import (
    ALL_GROUPS,
    LABELS,
    REFERENCE_GROUPS,
    DiveInnovations,
    Geometry,
    ReadDive,
)
from insdvl_replay.calibration.reference import with_reference
from insdvl_replay.calibration.rows import HeldOutRow, NoiseRow, ParameterRow
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import ConfigError, counted, listed, require_known
from insdvl_replay.core.runtime import track_progress
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.document.parts import Callout
from insdvl_replay.document.tables import numbers_apart

LITTLE_DRIFT: Final = 0.01  # so small a change of the drift on held-out dives is none
MORE_DRIFT: Final = "it increases the drift on held-out dives"
WORSE_NIS: Final = "it makes NIS/dof worse on held-out dives"
_ARM: Final = "arm "  # begins the label of a part of the lever arm
_AXES: Final = "xyz"


class CalibratedDives(NamedTuple):
    """A calibration, with what it was made from."""

    found: Calibration
    config: Config  # with the mounting that was found, if it was unknown
    kept: tuple[ReadDive, ...]  # the fitted dives
    innovations: list[DiveInnovations]  # of these


def require_groups(names: Sequence[str] | None, *, reference: bool) -> tuple[str, ...]:
    """Return the groups of parameters to estimate, by default all; an unknown one is a ConfigError."""
    known = REFERENCE_GROUPS if reference else ALL_GROUPS
    groups = known if names is None else tuple(name.strip() for name in names if name.strip())
    for name in groups:
        require_known("group of parameters", name, known)
    if not groups:
        raise ConfigError("no group of parameters is named", f"choose from {', '.join(known)}")
    return groups


def calibrate_dives(
    dives: Division,
    config: Config,
    groups: Sequence[str],
    *,
    reference: bool = False,  # compare with the references, and calibrate these, too
    one_delay: bool = False,  # for all dives
    mounting_unknown: bool = False,  # try 24 mountings first
    # of the drift without DVL; the first that the held-out dives have
    windows_s: Sequence[str] = OUTAGES_S,
) -> CalibratedDives:
    """Calibrate dives, and test the result on those that are held out."""
    known = Geometry.of(config.dvl)
    mountings = len(possible_axes(dives.fitted[0].dive.dvl))
    if mounting_unknown:
        config = with_mounting(config, likeliest_mounting(dives.fitted))
        dives = dives.with_config(config)
    asked = [dive.innovations() for dive in dives.fitted]
    found = calibrate(asked, config, groups, one_delay=one_delay)
    if reference:
        found = with_reference(found, dives.fitted, asked, groups)
    if mounting_unknown:
        found = found.from_mounting(known, mountings)
    noise = found.noise if found.proposes_noise else None
    tested = track_progress("testing on held-out dives", dives.held_out)
    others = [held_out_row(dive, found.change, noise, windows_s) for dive in tested]
    return CalibratedDives(replace(found, held_out=tuple(others)), config, dives.fitted, asked)


# --- The answer.


@dataclass(frozen=True)
class Answer:
    """What to do with the estimates of the geometry, and of the noise."""

    lines: tuple[Callout, ...]
    keeps_geometry: bool  # the estimates are worse than the settings
    keeps_noise: bool

    def applied(self, found: Calibration) -> Calibration:
        """Return the calibration with what is better alone: the rest is held, with the reason."""
        if self.keeps_geometry:
            found = replace(
                found,
                rows=tuple(_held(row) for row in found.rows),
                after=found.before,
                change=np.zeros_like(found.change),
                reference=None,
            )
        if self.keeps_noise:
            found = replace(found, noise_rows=tuple(_held_noise(row) for row in found.noise_rows))
        return found


def _held(row: ParameterRow) -> ParameterRow:
    if row.status != Estimated.ESTIMATED:
        return row
    return msgspec.structs.replace(row, status=Estimated.HELD, why=MORE_DRIFT)


def _held_noise(row: NoiseRow) -> NoiseRow:
    if not row.is_proposed:
        return row
    return msgspec.structs.replace(row, status=Estimated.HELD, why=WORSE_NIS, after=row.before)


def answer_of(found: Calibration) -> Answer:
    """Judge the geometry by the drift on held-out dives, and the noise by their NIS."""
    drift_m = _means(found.held_out, "drift_before_m", "drift_after_m")
    keeps_geometry = (
        bool(found.estimated) and drift_m.after > (1.0 + LITTLE_DRIFT) * drift_m.before
    )
    lines = []
    if any(row.status != Estimated.NOT_ASKED for row in found.all_rows):
        is_good = bool(found.estimated) and not keeps_geometry
        sentence = _geometry_sentence(found, drift_m, keeps=keeps_geometry)
        lines.append(Callout(sentence, "good" if is_good else "bad"))
    keeps_noise = False
    if found.proposes_noise:
        nis = _means(found.held_out, "nis_per_dof_before", "nis_per_dof_noise")
        keeps_noise = nis.dives > 0 and abs(math.log(nis.after)) > abs(math.log(nis.before))
        sentence = _noise_sentence(found, nis, keeps=keeps_noise)
        lines.append(Callout(sentence, "bad" if keeps_noise else "good"))
    return Answer(tuple(lines), keeps_geometry, keeps_noise)


@dataclass(frozen=True)
class _Means:
    """Geometric means over the held-out dives that have both values: each dive counts the same."""

    dives: int
    before: float  # NaN without dives, as the next
    after: float

    @property
    def change(self) -> str:
        """Both values, with as many digits as tell them apart."""
        return _change(self.before, self.after)


def _means(rows: Sequence[HeldOutRow], before: str, after: str) -> _Means:
    pairs = []
    for row in rows:
        old = finite(getattr(row, before))
        new = finite(getattr(row, after))
        if old > 0.0 and new > 0.0:
            pairs.append((old, new))
    if not pairs:
        return _Means(0, math.nan, math.nan)
    mean_old, mean_new = np.exp(np.log(pairs).mean(axis=0)).tolist()
    return _Means(len(pairs), mean_old, mean_new)


def _geometry_sentence(found: Calibration, drift_m: _Means, *, keeps: bool) -> str:
    """Say whether to use the new geometry."""
    names = _named(found.estimated)
    if not names:
        return "Keep your settings: these dives have no manoeuvre that determines others."
    if drift_m.dives:
        what = "Keep your settings" if keeps else "Use the new settings"
        dives = counted(drift_m.dives, "held-out dive")
        return f"{what}: on {dives} drift in 60 s without DVL {drift_m.change} m."
    untested = "Test them: `insdvl-replay calibrate ... --hold-out 0.3`"
    if found.held_out:
        untested = "The held-out dives have no window to test them"
    return f"New settings: {listed(names)}. {untested}."


def _named(rows: Sequence[ParameterRow]) -> list[str]:
    """Name parameters, the lever arm first as in the table; axes follow the name unless all are there."""
    axes: dict[str, str] = {}
    for row in sorted(rows, key=lambda row: not LABELS[row.parameter].startswith(_ARM)):
        label = LABELS[row.parameter].replace(_ARM, "lever arm ")
        name, _, axis = label.rpartition(" ")
        if axis in _AXES:
            axes[name] = axes.get(name, "") + axis
        else:
            axes[label] = ""
    names = []
    for name, of_name in axes.items():
        is_whole = of_name in ("", _AXES)
        names.append(name if is_whole else f"{name} {'/'.join(of_name)}")
    return names


def _noise_sentence(found: Calibration, nis: _Means, *, keeps: bool) -> str:
    """Say whether to use the new noise."""
    if nis.dives:
        what = "Keep your noise" if keeps else "Change the noise"
        dives = counted(nis.dives, "held-out dive")
        return f"{what}: NIS/dof on {dives} {nis.change}, expected 1."
    changes = []
    for row in found.noise_rows:
        if row.is_proposed:
            changes.append(f"{row.parameter} {_change(row.before, row.after)}")
    return f"Change the noise: {', '.join(changes)}."


def _change(before: float, after: float) -> str:
    return " -> ".join(numbers_apart(before, after))
