"""Calibration of a vehicle from its dives: estimates, standard deviations, and what is proposed."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from insdvl_replay.calibration.certainty import (
    MOSTLY,
    SEEN,
    Certainty,
    autocorrelation,
    certainty_of,
    correlations,
    effects_of_errors,
    mean_change,
    nis_by_errors,
    noise_share,
    own_delays,
    pulled,
    seen_by_motion,
    with_estimated_imu_errors,
)
from insdvl_replay.calibration.fit import DELAY_STEP_S, Fit, fit, scatter_of
from insdvl_replay.calibration.innovations import (
    ALL_GROUPS,
    DELAY,
    LATEST_S,
    NAMES,
    NO_CHANGE,
    NOISE,
    PARAMETERS,
    SCALE,
    DiveInnovations,
    Geometry,
    Parameter,
    ReadDive,
    moved_mounting,
    moved_pings,
)
from insdvl_replay.calibration.noise import (
    NO_GEOMETRY,
    FittedNoise,
    determined_noise,
    fit_noise,
    levelled,
    nis_per_dof,
    noise_row,
)
from insdvl_replay.calibration.rows import (
    DiveRow,
    HeldOutRow,
    NoiseRow,
    ParameterRow,
    ReferenceDiveRow,
    StartRow,
)
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Floats, Mask
from insdvl_replay.core.tables import Number, OutageRow
from insdvl_replay.core.words import Estimated
from insdvl_replay.evaluation.notes import CLASSES
from insdvl_replay.evaluation.outage_test import outage_test_table
from insdvl_replay.preparation.run import plan_runs, prepare_with_heading, run_candidates

# Least signal to noise of an estimate, where it is not `SEEN`. The levelling of a filter looks like a mounting: on a
# straight line the signal to noise is up to 3.3. On a long line with very stable accelerometers it is more (4.6 in
# 600 s, 9 in 1800 s), because a pitched DVL claims a depth at which gravity would be larger. A DVL that smooths, or
# stamps that jitter, look like a smaller scale.
LEAST_SEEN: Final = {"mounting": 4.0, "scale": 30.0}
SMOOTHED: Final = "a DVL that smooths would look the same"
NOISE_ALONE: Final = "not above the noise of this IMU"
# A step of fewer standard deviations ends the fit with the configured noise.
NEARLY_SETTLED: Final = 0.5
# An estimate further from the configuration, in sds of the prior, has another cause. A mounting that is determined well
# is proposed all the same, with a warning: many are configured as a quarter turn that they are not.
PLAUSIBLE_SDS: Final = 3.0
PLAUSIBLE_SCALE: Final = 0.05
MANY_TIMES: Final = 3.0  # Birge ratio from which dives contradict each other
# Signal to noise below which unmodelled errors, such as those of single beams, may be as large.
WEAK: Final = 10.0
CORRELATED: Final = 0.3
INSEPARABLE: Final = 0.9
# innovations that scatter by more, in their own sds, have another cause than the geometry
TOO_LARGE: Final = 2.0
OUTAGES_S: Final = ("60",)
AXES: Final = ("forward", "starboard", "down")

# indices of parameters that are left unchanged, and why
Refusals = Iterator[tuple[int, tuple[Estimated, str]]]


@dataclass(frozen=True)
class ReferenceCalibration:
    """The calibration of the references: ``[reference]`` before and after, with its tables."""

    before: Geometry
    after: Geometry
    rows: tuple[ParameterRow, ...]
    dives: tuple[ReferenceDiveRow, ...]
    starts: tuple[StartRow, ...]


@dataclass(frozen=True)
class Calibration:
    """The calibration of a vehicle from several dives."""

    before: Geometry
    after: Geometry  # what is proposed
    change: Floats  # (8,): what is proposed, zero where nothing is
    rows: tuple[ParameterRow, ...]
    dives: tuple[DiveRow, ...]
    warnings: tuple[str, ...]  # problems of the estimate
    fit: Fit  # of all parameters that were asked for, held ones included
    noise: FittedNoise  # proposed noise of the sensors
    noise_rows: tuple[NoiseRow, ...]
    held_out: tuple[HeldOutRow, ...] = ()
    tried: str = ""  # the likeliest mounting, if it was unknown
    reference: ReferenceCalibration | None = None

    def from_mounting(self, before: Geometry, mountings: int) -> "Calibration":
        """Report that so many mountings were tried first, with the configured geometry as ``before``."""
        roll, pitch, heading = self.before.mounting_rpy_deg
        tried = (
            f"of {mountings} mountings, roll {roll:g}, pitch {pitch:g}, heading {heading:g} deg is the likeliest. The "
            "changes of the mounting below start from it"
        )
        return replace(self, before=before, tried=tried)

    def change_of_dive(self, dive: int) -> Floats:
        """Return the proposed change with the dive's own delay, (8,)."""
        return self.fit.change(dive) * [row.status == Estimated.ESTIMATED for row in self.rows]

    @property
    def all_rows(self) -> tuple[ParameterRow, ...]:
        """The DVL's parameters, and those of the reference."""
        if self.reference is None:
            return self.rows
        return (*self.rows, *self.reference.rows)

    @property
    def estimated(self) -> tuple[ParameterRow, ...]:
        """The parameters that are proposed, the DVL's first."""
        return tuple(row for row in self.all_rows if row.status == Estimated.ESTIMATED)

    @property
    def proposes_noise(self) -> bool:
        """Whether any noise is proposed."""
        return any(row.is_proposed for row in self.noise_rows)


def calibrate(
    dives: Sequence[DiveInnovations],
    config: Config,
    groups: Collection[str] = ALL_GROUPS,
    *,
    one_delay: bool = False,
) -> Calibration:
    """Estimate the parameters that the dives determine, and leave the others unchanged."""
    asked = np.array([parameter.group in groups for parameter in PARAMETERS])

    def fitted(dives: Sequence[DiveInnovations], free: Mask, **how: Any) -> Fit:
        # A scale that is not observable and diverges makes the arm wrong, too.
        found = fit(dives, free, one_delay=one_delay, **how)
        if not _is_wild(mean_change(found)[SCALE]) or certainty_of(found).seen[SCALE] >= SEEN:
            return found
        return fit(dives, free & (np.arange(len(NAMES)) != SCALE), one_delay=one_delay, **how)

    # With a noise that is far off, the standard deviations are wrong. A noise fitted before the geometry hides it.
    first = fitted(dives, asked, settled=NEARLY_SETTLED)
    noise = fit_noise(dives, [first.change(i) for i in range(len(dives))])
    dives = [noise.applied(dive) for dive in dives]
    settled = fitted(dives, first.free, start=first.values)
    noise_shares = noise_share(settled, dives)
    found = seen_by_motion(settled, dives, noise_shares)
    effects = effects_of_errors(found, dives)
    with_imu_errors = with_estimated_imu_errors(found, effects)
    certainty = certainty_of(found, with_imu_errors, pulled(with_imu_errors, effects))
    refused = dict(_refused(certainty, mean_change(found), asked, noise_shares.min(axis=0)))
    free = asked & ~np.isin(np.arange(len(NAMES)), list(refused))
    # Held parameters were free in the fit: a held scale error of 2 % would move arm and delay by many sds.
    change = np.where(free, mean_change(found), 0.0)
    noise = levelled(noise, dives, [change] * len(dives))
    is_hidden = asked.any() and not free.any()
    if NOISE in groups and not is_hidden:
        own = config.filters[config.baseline]
        noise, noise_rows = determined_noise(
            noise, dives, [change] * len(dives), nis_by_errors(found, effects), own
        )
    else:
        status = Estimated.HELD if NOISE in groups else Estimated.NOT_ASKED
        why = NO_GEOMETRY if is_hidden else ""
        noise_rows = tuple(noise_row(noise, key, status, why) for key in noise.after)
    rows = tuple(parameter_rows(PARAMETERS, certainty, change, mean_change(found), asked, refused))
    dive_rows = tuple(_dive_rows([noise.applied(dive) for dive in dives], found, free))
    warnings = tuple(_warnings(found, certainty, free, dive_rows, noise_rows))
    before = Geometry.of(config.dvl)
    return Calibration(
        before,
        before.changed(change),
        change,
        rows,
        dive_rows,
        warnings,
        found,
        noise,
        noise_rows,
    )


def _dive_rows(dives: Sequence[DiveInnovations], found: Fit, free: Mask) -> Iterator[DiveRow]:
    """Yield delay and innovations of each dive; what is not free is as configured."""
    delays_s, sds_s = own_delays(found)
    for i, (dive, near) in enumerate(zip(dives, found.dives, strict=True)):
        before = scatter_of(dive.residuals(free * NO_CHANGE)).tolist()
        after = scatter_of(dive.residuals(free * found.change(i))).tolist()
        correlation = autocorrelation(near).tolist()
        yield DiveRow(
            dive.name,
            dive.count,
            dive.left_out,
            float(delays_s[i]) if free[DELAY] else None,
            float(sds_s[i]) if free[DELAY] else None,
            *before,
            *after,
            *correlation,
        )


def _is_far(row: int, change: float) -> bool:
    """Return whether an estimate is further from the configuration than usual."""
    return bool(abs(change) > PLAUSIBLE_SDS * PARAMETERS[row].prior_sd)


def _is_wild(scale: float) -> bool:
    return bool(abs(np.expm1(scale)) > PLAUSIBLE_SCALE)


def _refused(
    certainty: Certainty,
    change: Floats,
    asked: Mask,
    noise_shares: Floats,
) -> Refusals:
    for row in np.flatnonzero(asked).tolist():
        parameter = PARAMETERS[row]
        # The scale of this DVL includes the errors of its beams.
        seen = (certainty.seen if row == SCALE else certainty.signal_to_noise)[row]
        if noise_shares[row] > MOSTLY:
            yield row, (Estimated.HELD, f"{NOISE_ALONE}: needs {parameter.shown_by}")
        elif row == SCALE and SEEN <= seen < LEAST_SEEN["scale"]:
            yield row, (Estimated.HELD, SMOOTHED)
        elif seen < LEAST_SEEN.get(parameter.group, SEEN):
            yield row, (Estimated.HELD, f"needs {parameter.shown_by}")
        elif row == DELAY and abs(change[row]) > LATEST_S - DELAY_STEP_S:
            reason = "at the edge of the search range. Check the clocks and stamps"
            yield row, (Estimated.IMPLAUSIBLE, reason)
        elif row == SCALE and _is_wild(change[row]):
            reason = "larger than any error of the speed of sound. The DVL may smooth, or the stamps may jitter"
            yield row, (Estimated.IMPLAUSIBLE, reason)
        elif _is_far(row, change[row]) and not (parameter.group == "mounting" and seen >= WEAK):
            yield row, (Estimated.IMPLAUSIBLE, "too far from the configuration. Check the axes")


def parameter_rows(
    parameters: Sequence[Parameter],
    certainty: Certainty,
    proposed: Floats,
    found: Floats,
    asked: Mask,
    refused: Mapping[int, tuple[Estimated, str]],
) -> Iterator[ParameterRow]:
    """Yield the rows of the parameters: the proposed or rejected change, with its standard deviations."""
    for row, parameter in enumerate(parameters):
        if not asked[row]:
            yield ParameterRow(parameter.name, parameter.unit, status=Estimated.NOT_ASKED)
            continue
        status, why = refused.get(row, (Estimated.ESTIMATED, parameter.shown_by))
        change = {Estimated.HELD: 0.0, Estimated.IMPLAUSIBLE: found[row]}.get(
            status, proposed[row]
        )
        factor = parameter.shown_as
        yield ParameterRow(
            parameter.name,
            parameter.unit,
            change=finite_or_none(factor * change),
            formal_sd=finite_or_none(factor * certainty.formal[row]),
            correlated_sd=finite_or_none(factor * certainty.correlated[row]),
            between_dives_sd=finite_or_none(factor * certainty.between[row]),
            beams_sd=finite_or_none(factor * certainty.beams[row]),
            imu_sd=finite_or_none(factor * certainty.imu[row]),
            sd=finite_or_none(factor * certainty.sd[row]),
            signal_to_noise=finite_or_none(certainty.signal_to_noise[row]),
            birge=finite_or_none(certainty.birge[row]),
            status=status,
            why=why,
        )


def finite_or_none(value: float) -> Number:
    """Return a number for a row."""
    if np.isfinite(value):
        return float(value)
    return None


def _warnings(
    found: Fit,
    certainty: Certainty,
    free: Mask,
    dives: Sequence[DiveRow],
    noise: Sequence[NoiseRow],
) -> Iterator[str]:
    """Yield the warnings about the estimate."""
    for row in np.flatnonzero(free & (np.nan_to_num(certainty.birge) > MANY_TIMES)):
        yield (
            f"{NAMES[row]} differs between the dives by {certainty.birge[row]:.1f} times the expected scatter. "
            "The DVL may have been moved"
        )
    is_weak = free & (certainty.signal_to_noise < WEAK)
    weak = ", ".join(NAMES[row] for row in np.flatnonzero(is_weak))
    if weak:
        yield f"weakly observable, signal to noise below {WEAK:g}: {weak}. Test the result on other dives (--hold-out)"
    for index in np.flatnonzero(free).tolist():
        off = float(mean_change(found)[index])
        if _is_far(index, off):
            off_deg = off * PARAMETERS[index].shown_as
            yield f"{NAMES[index]} is {off_deg:+.1f} deg from the configuration. Check that the axes are right"
    for first, second, correlation in correlations(found, INSEPARABLE):
        yield f"{first} and {second} are strongly correlated ({correlation:+.2f})"
    for dive in dives:
        correlated = []
        for axis, scatter, correlation in zip(
            AXES, dive.axes("after"), dive.axes("autocorrelation"), strict=True
        ):
            if scatter > TOO_LARGE:
                yield (
                    f"{dive.dive}: innovations {axis} have {scatter:.1f} times their expected standard deviation. "
                    "Check axes and units"
                )
            elif correlation > CORRELATED:
                correlated.append(f"{axis} {correlation:.2f}")
        if correlated:
            yield (
                f"{dive.dive}: innovations are correlated (lag-1 correlation: {', '.join(correlated)}). The DVL "
                "smooths, or has less noise along these axes than along the others"
            )
    for found_noise in noise:
        if found_noise.status == Estimated.IMPLAUSIBLE:
            sensors = CLASSES[found_noise.parameter].name
            yield (
                f"{found_noise.parameter} is not proposed: {found_noise.why}. Vibration, jitter of the stamps, or "
                f"errors of geometry and delay are larger than the noise of the {sensors}"
            )


def held_out_row(
    read: ReadDive,
    change: Floats,
    noise: FittedNoise | None = None,
    windows_s: Sequence[str] = OUTAGES_S,
) -> HeldOutRow:
    """Return the row of a held-out dive: NIS and drift before and after a change, (8,), and NIS with a new noise."""
    asked = read.innovations()
    alone = read.alone
    prepared = prepare_with_heading(read.dive, alone)
    nis = []
    outages = []
    for tried in (NO_CHANGE, change):
        nis.append(float(np.mean(asked.runner(tried)(asked.filter).nis)) / 3.0)
        pings = moved_pings(prepared.velocities, tried).within(
            prepared.alignment.start_ns, prepared.end_ns
        )
        moved = replace(
            prepared, velocities=pings, mounting=moved_mounting(prepared.mounting, tried)
        )
        runs = run_candidates(
            read.dive, moved, plan_runs(read.dive, moved, alone, starts=0), alone
        )
        rows = outage_test_table(read.dive.name, runs.outages)
        outages.append(_first_outage(rows, windows_s))
    nis_before, nis_after = nis
    outage_before, outage_after = outages
    return HeldOutRow(
        dive=asked.name,
        nis_per_dof_before=nis_before,
        nis_per_dof_after=nis_after,
        windows=0 if outage_before is None else outage_before.windows,
        drift_before_m=None if outage_before is None else outage_before.drift_median_m,
        drift_after_m=None if outage_after is None else outage_after.drift_median_m,
        nis_per_dof_noise=None if noise is None else nis_per_dof(noise.applied(asked), change),
    )


def _first_outage(rows: Sequence[OutageRow], windows_s: Sequence[str]) -> OutageRow | None:
    """Return the row of the first length of windows that a dive has."""
    for window_s in windows_s:
        for row in rows:
            if row.window_s == window_s:
                return row
    return None
