"""A second start, with the heading of the vehicle instead of that of the reference.

A start on the reference knows its heading better than the vehicle did. Against a baseline that starts so well, an aid
that tells the heading looks useless or harmful. So filters that use heading or position run a second time, from a
heading that errs as `[initial]` says. Each dive has one draw, the same for all filters.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.dive_record import StartHeading
from insdvl_replay.core.states import AIDING, DEG, PHI
from insdvl_replay.core.words import HeadingSource
from insdvl_replay.nav.levelling import Start, start_with_error
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.prepared import Prepared

HEADING = PHI.stop - 1  # of the error states: the misalignment about down
STREAM = 0x48454144  # of random numbers that nothing else draws from


@dataclass(frozen=True)
class HeadingDraw:
    """A start with another heading, and the filters that run from it."""

    start: Start
    sd_deg: float
    error_deg: float
    # candidates that are run here, with the baseline's name; empty where there are none
    filters: Collection[str]
    solutions: Collection[str]  # recorded, so that the baseline alone runs


def heading_draw(
    dive: Dive,
    prepared: Prepared,
    config: Config,
    seed: int,
) -> HeadingDraw | None:
    """Draw the second start of a dive; None where the heading is not the reference's, or no candidate depends on it."""
    of_reference = prepared.alignment.heading_source in (
        HeadingSource.REFERENCE,
        HeadingSource.FIT,
    )
    if not of_reference or dive.reference is None or not _has_positions(dive, config):
        return None
    baseline, *candidates = prepared.filters
    if not depends_on_heading(baseline, config):
        candidates = [filter_ for filter_ in candidates if depends_on_heading(filter_, config)]
    names = {filter_.name for filter_ in candidates} | {*config.user_candidates}
    if not names and not config.solutions:
        return None
    sd = float(prepared.alignment.spread_start.sd[HEADING])
    # The sign is drawn. Sizes that are drawn, too, would scatter the logarithms of ratios by 1 and more over dives.
    is_left = np.random.default_rng(_seeds(dive, prepared, seed)).random() < 0.5
    error = sd
    if is_left:
        error = -sd
    start = turned_start(prepared.alignment.start, error, sd)
    return HeadingDraw(start, sd / DEG, error / DEG, {baseline.name, *names}, {*config.solutions})


def start_heading(prepared: Prepared, draw: HeadingDraw | None) -> StartHeading:
    """Say what the heading at the start comes from."""
    alignment = prepared.alignment
    sd_deg = float(alignment.start.sd[HEADING]) / DEG
    if draw is None:
        return StartHeading(alignment.heading_source, sd_deg)
    return StartHeading(alignment.heading_source, sd_deg, draw.sd_deg, draw.error_deg)


def depends_on_heading(filter_: ResolvedFilter, config: Config) -> bool:
    """Return whether a filter is aided by heading or position, or estimates one of them.

    Measurements of the user's own may be of any kind. A depth brings states of the position that it does not measure.
    """
    used = {*filter_.used_aiding}
    is_aided = not used.isdisjoint(("heading", "position")) or not used <= {*AIDING}
    return is_aided or not {*config.filters[filter_.name].states}.isdisjoint(
        ("heading_bias", "position")
    )


def turned_start(start: Start, error: float, sd: float) -> Start:
    """Turn a start by an error of its heading, rad, and give it the standard deviation of this error, or its own.

    What depends on the heading, as a velocity that the DVL measured, changes with it as the covariance says.
    """
    variance = float(start.cov[HEADING, HEADING])
    per_heading = start.cov[:, HEADING] / variance
    more = max(sd**2 - variance, 0.0)
    turned = start_with_error(start, per_heading[: len(start.sd)] * error)
    return replace(turned, cov=start.cov + more * np.outer(per_heading, per_heading))


def _has_positions(dive: Dive, config: Config) -> bool:
    is_located = dive.reference is not None and dive.reference.has_position
    return is_located or "position" in config.held_out.sensors


def _seeds(dive: Dive, prepared: Prepared, seed: int) -> tuple[int, ...]:
    """Return numbers by which dives differ, also those of equal length; they depend neither on name nor on format."""
    numbers = [
        seed,
        STREAM,
        len(dive.imu.time_ns),
        len(prepared.velocities.time_ns),
        prepared.end_ns - prepared.alignment.start_ns,
    ]
    if dive.imu_fingerprint is not None:
        numbers += [int(digest, 16) for digest in dive.imu_fingerprint.digests]
    return tuple(numbers)
