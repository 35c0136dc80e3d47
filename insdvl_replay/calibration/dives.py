"""A calibration of dives that were read: some are fitted, others held out to test it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from insdvl_replay.calibration.calibration import OUTAGES_S, Calibration, calibrate, held_out_row
from insdvl_replay.calibration.fit import likeliest_mounting, possible_axes, with_mounting
from insdvl_replay.calibration.innovations import ALL_GROUPS, REFERENCE_GROUPS, DiveInnovations, Geometry, ReadDive
from insdvl_replay.calibration.reference import with_reference
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.core.runtime import track_progress


class CalibratedDives(NamedTuple):
    """A calibration, with what it was made from."""

    found: Calibration
    config: Config  # with the mounting that was found, if it was unknown
    kept: list[ReadDive]  # the fitted dives
    innovations: list[DiveInnovations]  # of these


def require_groups(names: Sequence[str] | None, *, reference: bool) -> tuple[str, ...]:
    """Return the groups of parameters to estimate, by default all; an unknown one is a ConfigError."""
    known = REFERENCE_GROUPS if reference else ALL_GROUPS
    groups = known if names is None else tuple(name.strip() for name in names if name.strip())
    for name in groups:
        require_known("--only", name, known)
    if not groups:
        raise ConfigError("--only names nothing", f"choose from {', '.join(known)}, separated by commas")
    return groups


def calibrate_dives(
    dives: Sequence[ReadDive],
    config: Config,
    groups: Sequence[str],
    *,
    hold_out: Sequence[str] = (),  # shares, or names of dives
    reference: bool = False,  # compare with the references, and calibrate these, too
    one_delay: bool = False,  # for all dives
    mounting_unknown: bool = False,  # try 24 mountings first
    windows_s: Sequence[str] = OUTAGES_S,  # of the drift without DVL; the first that the held-out dives have
) -> CalibratedDives:
    """Calibrate dives, and test the result on those that are held out."""
    kept, held = _divided(dives, hold_out)
    known, mountings = Geometry.of(config.dvl), len(possible_axes(kept[0].dive.dvl))
    if mounting_unknown:
        config = with_mounting(config, likeliest_mounting(kept))
        kept, held = ([dive.with_config(config) for dive in some] for some in (kept, held))
    asked = [dive.innovations() for dive in kept]
    found = calibrate(asked, config, groups, one_delay=one_delay)
    found = with_reference(found, kept, asked, groups) if reference else found
    found = found.from_mounting(known, mountings) if mounting_unknown else found
    noise = found.noise if found.proposes_noise else None
    tested = track_progress("testing on held-out dives", held)
    others = [held_out_row(dive, found.change, noise, windows_s) for dive in tested]
    return CalibratedDives(replace(found, held_out=tuple(others)), config, kept, asked)


def _divided(dives: Sequence[ReadDive], hold_out: Sequence[str]) -> tuple[list[ReadDive], list[ReadDive]]:
    """Return the dives to fit and the held-out dives: a share of all, evenly spread, or those that are named."""
    names = [read.dive.name for read in dives]
    aside: set[int] = set()
    for wanted in hold_out:
        try:
            share = float(wanted)
        except ValueError:
            require_known("--hold-out", wanted, names)
            aside.update(row for row, name in enumerate(names) if name == wanted)
            continue
        if not 0.0 < share < 1.0:
            raise ConfigError(f"--hold-out {wanted}: a share is between 0 and 1", "for example --hold-out 0.3")
        count = max(1, round(share * len(names)))
        aside.update(len(names) - 1 - round(i * len(names) / count) for i in range(count))
    if len(aside) == len(names):
        raise ConfigError("--hold-out leaves no dive to fit", "name more dives, or hold out fewer")
    return (
        [read for row, read in enumerate(dives) if row not in aside],
        [read for row, read in enumerate(dives) if row in aside],
    )
