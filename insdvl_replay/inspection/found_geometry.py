"""Geometry and noise of the DVL in dives whose roles are found: calibrated, and tested on what was held out."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.calibration.calibration import Calibration
from insdvl_replay.calibration.dives import Answer, answer_of, calibrate_dives
from insdvl_replay.calibration.division import By, Division, middle
from insdvl_replay.calibration.fitted_noise import with_noise
from insdvl_replay.calibration.found import Given
from insdvl_replay.calibration.innovations import LABELS, NOISE, ReadDive, with_dvl
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, nanoseconds
from insdvl_replay.core.errors import Note, UserError
from insdvl_replay.core.notes import note

# What a calibration finds, by the settings that it replaces.
GROUPS: Final = {
    "arm": "lever_arm_m",
    "mounting": "mounting_rpy_deg",
    "delay": "latency_s",
    "scale": "scale",
}


def calibrated(
    dives: Sequence[Dive],
    config: Config,
    given: Given,
    notes: list[Note],
) -> Config:
    """Apply the calibration that is better on the held-out part; what is given is not calibrated."""
    geometry = [group for group, key in GROUPS.items() if not given.has(f"dvl.{key}")]
    fits_noise = not given.has("noise")
    if not geometry and not fits_noise:
        return config
    read = [middle(ReadDive(dive, config)) for dive in dives]
    read_with_s = read[0].config.dvl.latency_s
    groups = geometry or [NOISE]  # the noise is fitted once the geometry is known
    try:
        division = Division.found(read)
        windows_s = ("60", "30")
        found = calibrate_dives(division, config, groups, windows_s=windows_s).found
    except UserError as error:
        notes.append(note("found_calibration failed", why=error.what))
        return config
    better = _with_geometry(found, division, read, config, groups, notes)
    if better is not None:
        config = better
    if not fits_noise:
        return config
    # A noise belongs to the geometry with which it is fitted.
    late_s = config.dvl.latency_s - read_with_s
    later = [pings_later(dive, late_s) for dive in dives]
    return with_noise_of(later, config, given, is_tested=better is None)


def _with_geometry(
    found: Calibration,
    division: Division,  # from which it was found
    read: Sequence[ReadDive],
    config: Config,
    groups: Sequence[str],
    notes: list[Note],
) -> Config | None:
    """Return the settings with a better geometry, with a note on it; None where they stay as they are."""
    found, answer = _decided(found, division, config, groups)
    tested = _drift_sentence(found)
    if answer.keeps_geometry:
        notes.append(note("found_calibration not_applied", tested=tested))
        return None
    better = answer.applied(found)
    if found.estimated:
        # What was held out has shown that it helps; all together know it best.
        better = calibrate_dives(Division.nothing_held_out(read), config, groups).found
    changes = _changes(better)
    if changes:
        notes.append(
            note(
                "found_calibration",
                changes=", ".join(changes),
                tested=tested,
            )
        )
        return with_dvl(config, better.after.rounded())
    if groups != [NOISE]:
        notes.append(note("found_calibration unknown"))
    return None


def _decided(
    found: Calibration,
    division: Division,
    config: Config,
    groups: Sequence[str],
) -> tuple[Calibration, Answer]:
    """Judge a calibration by the drift of what was held out, else by its innovations."""
    answer = answer_of(found)
    if any(row.windows for row in found.held_out):
        return found, answer
    if division.by == By.TIME:  # each part of the dive alone by the other
        other = calibrate_dives(division.exchanged, config, groups, windows_s=("60",)).found
        found = replace(found, held_out=(*found.held_out, *other.held_out))
    before, after = _mean_nis(found)
    return found, replace(answer, keeps_geometry=bool(found.estimated) and after > before)


def _changes(found: Calibration) -> list[str]:
    """State by how much each parameter that is estimated has changed."""
    changes = []
    for row in found.estimated:
        if row.change is not None:
            changes.append(f"{LABELS[row.parameter]} {row.change:+.3g} {row.unit}")
    return changes


def with_noise_of(
    dives: Sequence[Dive],
    config: Config,
    given: Given,
    *,
    is_tested: bool = False,
) -> Config:
    """Fit the noise to dives; one that is tested is applied only where it is better on what was held out."""
    read = [middle(ReadDive(dive, config)) for dive in dives]
    division = Division.nothing_held_out(read)
    if is_tested:
        division = Division.found(read)
    found = calibrate_dives(division, config, [NOISE]).found
    return with_noise(config, answer_of(found).applied(found), given)


def pings_later(dive: Dive, latency_s: float) -> Dive:
    """Return a dive with the pings of another latency, which is subtracted from stamps as a log is read."""
    time_ns = dive.dvl.time_ns - nanoseconds(latency_s)
    return replace(dive, dvl=replace(dive.dvl, time_ns=time_ns))


def _drift_sentence(found: Calibration) -> str:
    """Say what the calibration does to the drift of what was held out, else to its NIS."""
    pairs = [(row.drift_before_m, row.drift_after_m) for row in found.held_out]
    if pairs and all(before and after for before, after in pairs):
        before_m, after_m = np.exp(np.mean(np.log(np.array(pairs, float)), axis=0)).tolist()
        return f"drift without DVL on what was held out {before_m:.3g} -> {after_m:.3g} m"
    before, after = _mean_nis(found)
    return f"NIS/dof on what was held out {before:.2g} -> {after:.2g}"


def _mean_nis(found: Calibration) -> tuple[float, float]:
    rows = [(row.nis_per_dof_before, row.nis_per_dof_after) for row in found.held_out]
    before, after = np.exp(np.mean(np.log(np.array(rows, float)), axis=0)).tolist()
    return before, after
