"""Clocks of tables that were not recorded together: stretched time columns, and offsets between tables.

A table whose times are equal steps from 0 to a round end often has one row too few: N rows at 1 Hz take N - 1 seconds,
not N. Tables that each begin at 0 have no common clock. Where the vehicle turns, the attitude of a reference shows its
offset from the gyros, and then the velocities of the DVL show theirs: by linear fits, so that no axes, signs, lever arm
or mounting need to be known. Offsets are settings that a replay subtracts from the times.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final

import numpy as np

from insdvl_replay.checks.imu import ENOUGH, turned_by
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.errors import UserError
from insdvl_replay.geometry.rotation import vector_from_mat
from insdvl_replay.inspection.settings import Setting, with_settings
from insdvl_replay.logs.columns.tables import read_tables
from insdvl_replay.logs.columns.topics import LOG_TIME, PROPOSED
from insdvl_replay.logs.formats.fields import TABLE
from insdvl_replay.logs.formats.recording import Recording
from insdvl_replay.logs.read import RoleColumns, find_roles

FARTHEST_S: Final = 5.0  # offset that is looked for, either sign
STEP_S: Final = 0.02
LEAST_S: Final = 0.03  # smaller offsets are left to `calibrate`
CLEAR: Final = 0.5  # part of the usual misfit that the best offset must leave at most
_SINCE_1970_S: Final = 1e8  # larger times are those of a common clock
_RATE_WINDOW_S: Final = 0.1  # over which angular rates are averaged


def stretched_rate_hz(time_ns: TimeNs) -> float | None:
    """Return the rate of a table whose times are equal steps over N periods for N rows; None for others."""
    count = len(time_ns)
    if count <= ENOUGH or np.ptp(np.diff(time_ns)) > 2:
        return None
    span_s = float(time_ns[-1] - time_ns[0]) / NS_PER_S
    if span_s <= 0.0:
        return None
    rate_hz = count / span_s
    written_hz = (count - 1) / span_s
    is_round = [
        any(abs(x - float(f"{x:.2g}")) < 1e-8 * x for x in (hz, 1.0 / hz))
        for hz in (rate_hz, written_hz)
    ]
    # of two digits, as rate or as period
    if is_round == [True, False]:
        return float(f"{rate_hz:.9g}")
    return None


def table_clock_settings(log: Recording, config: Config) -> Iterator[Setting]:
    """Propose rates and offsets for the roles that tables play."""
    place = str(log.path)
    times = log.log_times()
    rates = list[Setting]()
    sources = {
        finding.role: finding.sources[0]
        for finding in find_roles(place, log.channels, config)
        if finding.role in PROPOSED
        and finding.sources
        and finding.sources[0].channels[0].encoding == TABLE
    }
    for role, source in sources.items():
        time_ns = times[source.channels[0].id]
        rate_hz = stretched_rate_hz(time_ns) if source.stamp == LOG_TIME else None
        if rate_hz is not None:
            count = len(time_ns)
            end_s = float(time_ns[-1]) / NS_PER_S
            text = (
                f"{source.topic}: its clock is {100.0 / (count - 1):.2g} % too slow: {count} rows in equal steps end "
                f"at {end_s:g} s; at {rate_hz:g} Hz they end a step earlier"
            )
            rates.append(Setting(f"{role}.stamp", f"{rate_hz:g} Hz", text))
    yield from rates
    starts_s = [float(times[source.channels[0].id][0]) / NS_PER_S for source in sources.values()]
    if len({source.topic for source in sources.values()}) < 2 or max(starts_s) > _SINCE_1970_S:
        return
    config = with_settings(config, rates)
    columns = RoleColumns(place, config)
    for finding in find_roles(place, log.channels, config):
        if finding.role in sources:
            with suppress(UserError):  # whoever replays reports it
                columns.decode(finding.role, read_tables(log, finding.sources))
    imu = columns.imu
    dvl = columns.dvl
    reference = columns.reference
    if imu is None or reference is None or "reference" not in sources:
        return
    by_attitude_s = _best_offset_s(lambda offset_s: _attitude_misfit(imu, reference, offset_s))
    if by_attitude_s is None:
        return
    why = "the tables have no common clock"
    if abs(by_attitude_s) > LEAST_S:
        text = f"{sources['reference'].topic}: {why}; its attitude fits the gyros {by_attitude_s:+.2f} s later"
        yield Setting(
            "reference.latency_s", round(config.reference.latency_s - by_attitude_s, 3), text
        )
    if "dvl" in sources and len(dvl.time_ns) and reference.has_attitude:
        at_s = seconds(reference.time_ns, imu.time_ns[0]) + by_attitude_s
        velocity_b = np.einsum("kji,kj->ki", reference.mat_nb, reference.velocity_n)
        by_velocity_s = _best_offset_s(
            lambda offset_s: _velocity_misfit(imu, dvl, at_s, velocity_b, offset_s)
        )
        if by_velocity_s is not None and abs(by_velocity_s) > LEAST_S:
            text = f"{sources['dvl'].topic}: {why}; its velocities fit reference and gyros {by_velocity_s:+.2f} s later"
            yield Setting("dvl.latency_s", round(config.dvl.latency_s - by_velocity_s, 3), text)


def _best_offset_s(misfit: Callable[[float], float]) -> float | None:
    """Return the offset with the least misfit, between the steps by a parabola; None where none stands out."""
    offsets_s = np.arange(-FARTHEST_S, FARTHEST_S + STEP_S, STEP_S)
    misfits = np.array([misfit(offset_s) for offset_s in offsets_s.tolist()])
    if not np.isfinite(misfits).all():
        return None
    best = int(np.argmin(misfits))
    if not 0 < best < len(misfits) - 1 or misfits[best] > CLEAR * np.median(misfits):
        return None
    before, least, after = misfits[best - 1 : best + 2]
    curve = before - 2.0 * least + after
    return float(
        offsets_s[best] + (0.5 * STEP_S * (before - after) / curve if curve > 0.0 else 0.0)
    )


def _attitude_misfit(imu: ImuColumns, reference: ReferenceColumns, offset_s: float) -> float:
    """Return the median difference of the angles by which reference and gyros turn from attitude to attitude."""
    known = np.isfinite(reference.mat_nb).all(axis=(1, 2))
    mat_nb = reference.mat_nb[known]
    at_s = seconds(reference.time_ns[known], imu.time_ns[0]) + offset_s
    inside = (at_s >= 0.0) & (at_s <= float(imu.time_ns[-1] - imu.time_ns[0]) / NS_PER_S)
    if np.count_nonzero(inside) <= ENOUGH:
        return np.inf
    mat_nb = mat_nb[inside]
    at_s = at_s[inside]
    turned = np.linalg.norm(vector_from_mat(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:]), axis=1)
    summed = np.linalg.norm(np.diff(turned_by(imu, at_s), axis=0), axis=1)
    return float(np.sqrt(np.mean((summed - turned) ** 2)))


def _velocity_misfit(
    imu: ImuColumns, dvl: DvlColumns, at_s: Floats, velocity_b: Floats, offset_s: float
) -> float:
    """Return the residual of pings as linear functions of the reference's velocity and of the angular rate."""
    pings = dvl.velocity_d if dvl.velocity_d is not None else dvl.beam_velocity_mps
    ping_s = seconds(dvl.time_ns, imu.time_ns[0]) + offset_s
    known = np.isfinite(velocity_b).all(axis=1)
    last_s = float(imu.time_ns[-1] - imu.time_ns[0]) / NS_PER_S
    if pings is None or np.count_nonzero(known) <= ENOUGH:
        return np.inf
    inside = (ping_s > max(at_s[known][0], FARTHEST_S)) & (
        ping_s < min(at_s[known][-1], last_s - FARTHEST_S)
    )
    inside &= np.isfinite(pings).all(axis=1)
    if np.count_nonzero(inside) <= 4 * ENOUGH:
        return np.inf
    ping_s = ping_s[inside]
    measured = pings[inside]
    moving = np.column_stack(
        [np.interp(ping_s, at_s[known], column) for column in velocity_b[known].T]
    )
    half_s = 0.5 * _RATE_WINDOW_S
    turning = (turned_by(imu, ping_s + half_s) - turned_by(imu, ping_s - half_s)) / _RATE_WINDOW_S
    regressors = np.column_stack([moving, turning, np.ones(len(ping_s))])
    solved, *_ = np.linalg.lstsq(regressors, measured, rcond=None)
    return float(np.sqrt(np.mean((measured - regressors @ solved) ** 2)))
