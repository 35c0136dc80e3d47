"""A vehicle calibrated from its dives: what was found, how sure it is, what is proposed and what is not."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from insdvl_replay.calibration.certainty import (
    SEEN,
    Certainty,
    autocorrelation,
    certainty_of,
    correlations,
    mean_change,
    own_delays,
)
from insdvl_replay.calibration.considered import beside_imu_errors, effects_of_errors, nis_by_errors, pulled
from insdvl_replay.calibration.fit import DELAY_STEP_S, Fit, Mask, fit, scatter_of
from insdvl_replay.calibration.innovations import LATEST_S, DiveInnovations
from insdvl_replay.calibration.motion import MOSTLY, noise_share, seen_by_motion
from insdvl_replay.calibration.noise import (
    NO_GEOMETRY,
    FittedNoise,
    fit_noise,
    judged_noise,
    levelled,
    noise_doubts,
    noise_rows,
)
from insdvl_replay.calibration.parameters import (
    ALL_GROUPS,
    DELAY,
    NAMES,
    NOISE,
    PARAMETERS,
    SCALE,
    DvlGeometry,
    Parameter,
)
from insdvl_replay.calibration.reference_parameters import ReferenceGeometry
from insdvl_replay.calibration.rows import DiveRow, HeldOutRow, NoiseRow, ParameterRow, ReferenceDiveRow, StartRow
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.table import Number
from insdvl_replay.core.words import Estimated

LEAST_SEEN: Final = {"mounting": 4.0, "scale": 30.0}
"""Signal to noise from which something is moved, where it is not `SEEN`: how a filter finds its level looks like a
mounting, which a straight line shows with up to 3.3, and more where it is long beside accelerometers so steady that
they feel gravity grow with the depth that a pitched DVL claims (4.6 in 600 s, 9 in 1800 s); a DVL that smooths, or
stamps that jitter, look like a smaller scale."""
SMOOTHED: Final = "seen, but not beyond what a DVL that smooths would look like"
NOISE_ALONE: Final = "not seen beyond the noise of this IMU"
NEARLY_SETTLED: Final = 0.5
"""A step of less than so many standard deviations ends the fit with the noise that is configured."""
BELIEVABLE_SDS: Final = 3.0
"""An estimate further from the configuration, in sds of the prior, comes from something else."""
BELIEVABLE_SCALE: Final = 0.05
MANY_TIMES: Final = 3.0
"""Birge ratio from which dives contradict each other."""
WEAK: Final = 10.0
"""Signal to noise below which what no model knows, such as the errors of single beams, may be as large."""
CORRELATED: Final = 0.3
INSEPARABLE: Final = 0.9
TOO_LARGE: Final = 2.0
"""Innovations that scatter by more, in their own sds, hold something that no geometry explains."""
AXES: Final = ("forward", "starboard", "down")


@dataclass(frozen=True)
class ReferenceCalibration:
    """What the dives' references say of themselves: ``[reference]`` before and after, and what that rests on."""

    before: ReferenceGeometry
    after: ReferenceGeometry
    rows: tuple[ParameterRow, ...]
    dives: tuple[ReferenceDiveRow, ...]
    starts: tuple[StartRow, ...] = ()


@dataclass(frozen=True)
class Calibration:
    """What several dives say of their vehicle."""

    before: DvlGeometry
    after: DvlGeometry  # what is proposed
    change: Floats  # shape (8,): what is proposed, zero where nothing is
    rows: tuple[ParameterRow, ...]
    dives: tuple[DiveRow, ...]
    doubts: tuple[str, ...]  # what speaks against believing it
    fit: Fit  # of all that was asked for, with what is then held
    noise: FittedNoise  # what is proposed of the sensors
    noise_rows: tuple[NoiseRow, ...]
    held_out: tuple[HeldOutRow, ...] = ()
    tried: str = ""  # which mounting was tried first, where nobody knew it
    reference: ReferenceCalibration | None = None

    def with_held_out(self, rows: Sequence[HeldOutRow]) -> "Calibration":
        """Add how dives fare that were not fitted."""
        return replace(self, held_out=tuple(rows))

    def from_mounting(self, before: DvlGeometry, ways: int) -> "Calibration":
        """Tell that so many ways of mounting were tried first, and what the configuration says in their place."""
        roll, pitch, heading = self.before.mounting_rpy_deg
        tried = (
            f"of {ways} mountings, roll {roll:g}, pitch {pitch:g}, heading {heading:g} deg is the likeliest; changes "
            "of the mounting are from there"
        )
        return replace(self, before=before, tried=tried)

    def change_of_dive(self, dive: int) -> Floats:
        """Return what is proposed with the dive's own delay, shape (8,)."""
        return self.fit.of_dive(dive) * [row.status == Estimated.ESTIMATED for row in self.rows]

    @property
    def estimated(self) -> tuple[ParameterRow, ...]:
        """The parameters that are proposed, the DVL's first."""
        return tuple(row for row in self.all_rows if row.status == Estimated.ESTIMATED)

    @property
    def proposes_noise(self) -> bool:
        """Whether any noise is proposed."""
        return any(row.is_proposed for row in self.noise_rows)

    @property
    def all_rows(self) -> tuple[ParameterRow, ...]:
        """The DVL's parameters, and those of the reference."""
        return (*self.rows, *(() if self.reference is None else self.reference.rows))


def calibrate(
    dives: Sequence[DiveInnovations], config: Config, groups: Collection[str] = ALL_GROUPS, *, one_delay: bool = False
) -> Calibration:
    """Estimate what the dives show, and leave the rest as it is."""
    asked = np.array([parameter.group in groups for parameter in PARAMETERS])
    # Of a noise that is far off, the standard deviations are, and a noise that is fitted before the geometry hides it.
    first = _fitted(dives, asked, one_delay=one_delay, settled=NEARLY_SETTLED)
    noise = fit_noise(dives, [first.of_dive(i) for i in range(len(dives))])
    dives = [noise.applied(dive) for dive in dives]
    settled = _fitted(dives, first.unknowns.free, one_delay=one_delay, start=first.values)
    noise_shares = noise_share(settled, dives)
    all_at_once = seen_by_motion(settled, dives, noise_shares)
    effects = effects_of_errors(all_at_once, dives)
    beside = beside_imu_errors(all_at_once, effects)
    certainty = certainty_of(all_at_once, beside, pulled(beside, effects))
    refused = dict(_refused(certainty, mean_change(all_at_once), asked, noise_shares.min(axis=0)))
    free = asked & np.array([row not in refused for row in range(len(PARAMETERS))])
    # Told with what is held free: a scale of 2 % that is held would be taken for arm and delay, beyond all their sds.
    change = np.where(free, mean_change(all_at_once), 0.0)
    noise = levelled(noise, dives, [change] * len(dives))
    held = NO_GEOMETRY if asked.any() and not free.any() else ""
    if NOISE in groups and not held:
        by_errors = nis_by_errors(all_at_once, effects)
        noise, of_noise = judged_noise(noise, dives, [change] * len(dives), by_errors, config)
    else:
        status = Estimated.HELD if NOISE in groups else Estimated.NOT_ASKED
        of_noise = noise_rows(noise, dict.fromkeys(noise.after, (status, held)), {})
    before = DvlGeometry.of(config)
    rows = tuple(parameter_rows(PARAMETERS, certainty, change, mean_change(all_at_once), asked, refused))
    of_dives = tuple(_dive_rows([noise.applied(dive) for dive in dives], all_at_once, free))
    doubts = (*_doubts(all_at_once, certainty, free), *_doubts_of_dives(of_dives), *noise_doubts(of_noise))
    return Calibration(before, before.changed(change), change, rows, of_dives, doubts, all_at_once, noise, of_noise)


def _fitted(dives: Sequence[DiveInnovations], asked: Mask, **how: Any) -> Fit:
    """Fit all that is asked for, without a scale that nothing shows and that runs away, and takes the arm with it."""
    found = fit(dives, asked, **how)
    if not _is_wild(mean_change(found)[SCALE]) or certainty_of(found).seen[SCALE] >= SEEN:
        return found
    return fit(dives, asked & (np.array(NAMES) != NAMES[SCALE]), **how)


def _is_wild(scale: float) -> bool:
    return bool(abs(np.expm1(scale)) > BELIEVABLE_SCALE)


def _refused(
    certainty: Certainty, change: Floats, asked: Mask, noise_shares: Floats
) -> Iterator[tuple[int, tuple[Estimated, str]]]:
    """Find what must stay as it is, and why."""
    for row in np.flatnonzero(asked).tolist():
        parameter = PARAMETERS[row]
        # What beams may be off by is a part of the scale that this DVL has.
        seen = (certainty.seen if row == SCALE else certainty.signal_to_noise)[row]
        least = LEAST_SEEN.get(parameter.group, SEEN)
        if noise_shares[row] > MOSTLY:
            yield row, (Estimated.HELD, f"{NOISE_ALONE}: needs {parameter.shown_by}")
        elif seen < least:
            yield row, (Estimated.HELD, SMOOTHED if row == SCALE and seen >= SEEN else f"needs {parameter.shown_by}")
        elif row == DELAY and abs(change[row]) > LATEST_S - DELAY_STEP_S:
            yield row, (Estimated.DOUBTFUL, "at the edge of what is looked at: are the clocks the same?")
        elif row == SCALE and _is_wild(change[row]):
            yield row, (Estimated.DOUBTFUL, "no sound of speed is so wrong: does the DVL smooth, or the stamps jitter?")
        elif abs(change[row]) > BELIEVABLE_SDS * parameter.prior_sd:
            yield row, (Estimated.DOUBTFUL, "too far from the configuration: are the axes right?")


def parameter_rows(
    parameters: Sequence[Parameter],
    certainty: Certainty,
    proposed: Floats,
    found: Floats,
    asked: Mask,
    refused: Mapping[int, tuple[Estimated, str]],
) -> Iterator[ParameterRow]:
    """Lay out parameters in their order: what is proposed, what was found and is not believed, and how sure each is."""
    for row, parameter in enumerate(parameters):
        if not asked[row]:
            yield ParameterRow(parameter.name, parameter.unit, status=Estimated.NOT_ASKED)
            continue
        status, why = refused.get(row, (Estimated.ESTIMATED, parameter.shown_by))
        change = {Estimated.HELD: 0.0, Estimated.DOUBTFUL: found[row]}.get(status, proposed[row])
        shown = parameter.shown_as
        yield ParameterRow(
            parameter.name,
            parameter.unit,
            shown * float(change),
            _number(shown * certainty.formal[row]),
            _number(shown * certainty.correlated[row]),
            _number(shown * certainty.between[row]),
            _number(shown * certainty.beams[row]),
            _number(shown * certainty.imu[row]),
            _number(shown * certainty.sd[row]),
            _number(certainty.signal_to_noise[row]),
            _number(certainty.birge[row]),
            status,
            why,
        )


def _number(value: float) -> Number:
    return float(value) if np.isfinite(value) else None


def _dive_rows(dives: Sequence[DiveInnovations], found: Fit, free: Mask) -> Iterator[DiveRow]:
    delays_s, sds_s = own_delays(found)
    is_free = bool(free[DELAY])
    for i, (dive, near) in enumerate(zip(dives, found.dives, strict=True)):
        before, after = (scatter_of(dive.residuals(free * at)) for at in (np.zeros(len(NAMES)), found.of_dive(i)))
        yield DiveRow(
            dive.name,
            dive.count,
            dive.left_out,
            float(delays_s[i]) if is_free else None,
            float(sds_s[i]) if is_free else None,
            *(_triple(axes) for axes in (before, after, autocorrelation(near))),
        )


def _triple(axes: Floats) -> tuple[float, float, float]:
    x, y, z = axes.tolist()
    return x, y, z


def _doubts(found: Fit, certainty: Certainty, free: Mask) -> Iterator[str]:
    """State what the fit itself says against the answer."""
    for row in np.flatnonzero(free & (np.nan_to_num(certainty.birge) > MANY_TIMES)):
        yield (
            f"the dives differ in {PARAMETERS[row].name} {certainty.birge[row]:.1f} times as much as each is sure: "
            "was the DVL moved between them?"
        )
    if weak := [row for row in np.flatnonzero(free) if certainty.signal_to_noise[row] < WEAK]:
        names = ", ".join(PARAMETERS[row].name for row in weak)
        yield f"weakly seen, signal to noise below {WEAK:g}: {names}; try them on other dives (--hold-out)"
    for one, other, correlation in correlations(found, INSEPARABLE):
        yield f"{one} and {other} can hardly be told apart (correlation {correlation:+.2f})"


def _doubts_of_dives(dives: Sequence[DiveRow]) -> Iterator[str]:
    """State what the innovations that are left say against it."""
    for dive in dives:
        for axis, scatter, correlation in zip(AXES, dive.after, dive.autocorrelation, strict=True):
            if scatter > TOO_LARGE:
                yield (
                    f"{dive.dive}: innovations {axis} still scatter by {scatter:.1f} of their standard deviations: "
                    "wrong axes or units"
                )
            elif correlation > CORRELATED:
                yield (
                    f"{dive.dive}: neighbouring innovations {axis} are alike ({correlation:.2f}): the DVL smooths, "
                    "or is less noisy along this axis than along others"
                )
