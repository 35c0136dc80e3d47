"""The heading at the start where only the positions of a reference tell it (``initial.heading_deg = "fit"``).

The baseline is run, its track laid on the reference's, and run again from what was found. Started far off, a good IMU
feels that the Earth turns otherwise, and the filter bends the track: so this takes some rounds. The baseline is as sure
of its heading as configured, and surer of its gyros, for a filter that is unsure turns by itself.
"""

from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.dive_columns import Dive, ReferenceColumns
from insdvl_replay.core.errors import ConfigError, LogError, Note, error_context
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG, DEG_PER_HOUR
from insdvl_replay.evaluation.drift import HeadingFit, heading_fit
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.preparation.running import prepared_timeline, run_one

FIT: Final = "fit"
MOST_ROUNDS: Final = 6
SETTLED_DEG: Final = 0.02
HEADING_STEP_DEG: Final = 1.0
BIAS_STEP: Final = 0.2
"""In its standard deviation beforehand."""
HELD_BIAS_DEGPH: Final = 1.0
"""A filter that may move its biases mistakes what beams and accelerometers are off by for a turn."""
LEAST_SURE_DEG: Final = 15.0
"""A heading that a track tells no better says nothing."""
HEADING_DIGITS, BIAS_DIGITS = 2, 1
"""Decimals; neither is known so well."""
_BY_HAND: Final = "--set initial.heading_deg=... says it, from north over east"


@dataclass(frozen=True)
class FittedStart:
    """A start that was fitted to the track of a reference.

    Attributes
    ----------
    heading_deg, heading_sd_deg : float
    gyro_bias_degph, gyro_bias_sd_degph : float
        About down: what is configured is a measurement, too.
    """

    heading_deg: float
    heading_sd_deg: float
    gyro_bias_degph: float
    gyro_bias_sd_degph: float

    def in_config(self, config: Config) -> Config:
        """Start from it, as sure as the track is, or less where the configuration is."""
        initial = config.initial
        north, east, down = initial.misalignment_sd_deg
        sds = (north, east, max(down, round(self.heading_sd_deg, HEADING_DIGITS)))
        return _started(config, self.heading_deg, self.gyro_bias_degph, misalignment_sd_deg=sds)

    @property
    def text(self) -> str:
        """For people."""
        return (
            f"a heading of {self.heading_deg:.{HEADING_DIGITS}f} +- {self.heading_sd_deg:.2g} deg at the start, and a "
            f"bias of {self.gyro_bias_degph:.{BIAS_DIGITS}f} +- {self.gyro_bias_sd_degph:.2g} deg/h of the gyro about "
            "down, were fitted to the positions of the reference, which the tables then compare with"
        )


def prepare_with_heading(dive: Dive, config: Config) -> Prepared:
    """Do all that comes before the filters, and find the heading at the start where it is to be fitted.

    Parameters
    ----------
    dive : Dive
        From `prepared.with_reference_at_imu`.

    Raises
    ------
    LogError, ConfigError
        As of `prepared.prepare_dive` and `fitted_start`.
    """
    if not is_to_be_fitted(dive, config.initial):
        return prepare_dive(dive, config)
    fitted = fitted_start(dive, config)
    prepared = prepare_dive(dive, fitted.in_config(config))
    return replace(prepared, notes=(*prepared.notes, Note("start_heading_fitted", fitted.text)))


def is_to_be_fitted(dive: Dive, initial: Initial) -> bool:
    """Return whether the heading at the start is asked for of the track; an attitude to start from goes before it."""
    has_attitude = dive.reference is not None and dive.reference.has_attitude
    return initial.heading_deg == FIT and not (initial.source == "reference" and has_attitude)


def fitted_start(dive: Dive, config: Config) -> FittedStart:
    """Find the heading at the start, and the gyro's bias about down, from which the tracks agree.

    Parameters
    ----------
    dive : Dive
        From `prepared.with_reference_at_imu`.
    config : Config
        Its heading does not count.

    Raises
    ------
    ConfigError
        The dive has no reference with positions.
    LogError
        Its track is too short to tell a heading.
    """
    with error_context(dive.name):
        if dive.reference is None or not dive.reference.has_position:
            raise ConfigError(
                'initial.heading_deg = "fit" needs positions of a reference, and there are none',
                f"name them (reference.topic or reference.fix), or {_BY_HAND}",
            )
    baseline = {config.baseline: config.filters[config.baseline]}
    config = msgspec.structs.replace(config, filters=baseline)
    heading_deg, bias_degph = 0.0, config.initial.gyro_bias_degph[2]
    found = HeadingFit(np.inf, np.inf, 0.0, np.inf)
    for _ in range(MOST_ROUNDS):
        if abs(found.heading) < SETTLED_DEG * DEG:
            break
        found = _fit(dive, dive.reference, config, heading_deg, bias_degph)
        heading_deg = round((heading_deg + found.heading / DEG) % 360.0, HEADING_DIGITS)
        bias_degph = round(bias_degph + found.bias / DEG_PER_HOUR, BIAS_DIGITS)
    # A bias that walks is, over the dive, another than at the start.
    time_s = np.ptp(dive.reference.time_ns[dive.reference.known["positions"]]) * 1e-9
    bias_sd = np.hypot(found.bias_sd, config.noise.gyro_bias_walk_radps_rts * np.sqrt(time_s / 3.0))
    return FittedStart(heading_deg, found.heading_sd / DEG, bias_degph, float(bias_sd) / DEG_PER_HOUR)


def _fit(dive: Dive, reference: ReferenceColumns, config: Config, heading_deg: float, bias_degph: float) -> HeadingFit:
    """Run the baseline from a start and from two beside it: the filter itself finds a part of either, and turns."""
    prior_sd_degph = config.initial.gyro_bias_sd_degph
    bias_step_degph = BIAS_STEP * prior_sd_degph
    starts = ((heading_deg, bias_degph), (heading_deg + HEADING_STEP_DEG, bias_degph),
              (heading_deg, bias_degph + bias_step_degph))  # fmt: skip
    placed = reference.rows(reference.known["positions"])
    histories = [_run(dive, _started(config, *start, gyro_bias_sd_degph=HELD_BIAS_DEGPH)) for start in starts]
    time_ns, ours, theirs = np.intersect1d(histories[0].time_ns, placed.time_ns, return_indices=True)
    tracks = [history.position[ours] for history in histories]
    origin = placed.position[theirs[:1]]
    reference_m, track_m, turned_m, biased_m = (
        np.stack(north_east_m(track, origin, origin), axis=1) for track in (placed.position[theirs], *tracks)
    )
    per_heading_m = (turned_m - track_m) / (HEADING_STEP_DEG * DEG)
    per_bias_m = (biased_m - track_m) / (bias_step_degph * DEG_PER_HOUR)
    off_degph = bias_degph - config.initial.gyro_bias_degph[2]
    known = off_degph * DEG_PER_HOUR, prior_sd_degph * DEG_PER_HOUR
    found = heading_fit(time_ns, track_m, per_heading_m, per_bias_m, reference_m, known)
    if found is None or not found.heading_sd < LEAST_SURE_DEG * DEG:
        raise LogError(
            f"{dive.name}: the track of the reference does not tell the heading at the start",
            f"some tens of metres over two minutes would, of gyros that turn by little meanwhile; {_BY_HAND}",
        )
    return found


def _run(dive: Dive, config: Config) -> History:
    prepared = prepare_dive(dive, config)
    return run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared))


def _started(
    config: Config, heading_deg: float, bias_degph: float, **others: float | tuple[float, float, float]
) -> Config:
    initial = config.initial
    bias = (*initial.gyro_bias_degph[:2], bias_degph)
    started = msgspec.structs.replace(initial, heading_deg=heading_deg, gyro_bias_degph=bias, **others)
    return msgspec.structs.replace(config, initial=started)
