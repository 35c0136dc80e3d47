"""Clocks of tables that were not recorded together: stretched time columns, and offsets between tables.

A table whose times are equal steps from 0 to a round end often has one row too few: N rows at 1 Hz take N - 1 seconds,
not N. Tables that each begin at 0 have no common clock. Where the vehicle turns, the attitude of a reference shows its
offset from the gyros, and then the velocities of the DVL show theirs: by linear fits, so that no axes, signs, lever arm
or mounting need to be known. Offsets are settings that a replay subtracts from the times.
"""

from collections.abc import Callable, Iterator, Mapping
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
from insdvl_replay.logs.columns.topics import LOG_TIME, PROPOSED, Source
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
    if _is_round(rate_hz) and not _is_round(written_hz):
        return float(f"{rate_hz:.9g}")
    return None


def _is_round(rate_hz: float) -> bool:
    """Return whether a rate has two digits at most, or its period has."""
    return _has_two_digits(rate_hz) or _has_two_digits(1.0 / rate_hz)


def _has_two_digits(number: float) -> bool:
    return abs(number - float(f"{number:.2g}")) < 1e-8 * number


def table_clock_settings(log: Recording, config: Config) -> Iterator[Setting]:
    """Propose rates and offsets for the roles that tables play."""
    times = log.log_times()
    sources = _tables_of_roles(log, config)
    topics: set[str] = set()
    starts_s = []
    rates: list[Setting] = []
    for role, source in sources.items():
        time_ns = times[source.channels[0].id]
        topics.add(source.topic)
        starts_s.append(float(time_ns[0]) / NS_PER_S)
        rates += _rate_setting(role, source, time_ns)
    yield from rates
    has_common_clock = len(topics) < 2 or max(starts_s) > _SINCE_1970_S
    if not has_common_clock:
        yield from _offset_settings(log, sources, with_settings(config, rates))


def _tables_of_roles(log: Recording, config: Config) -> dict[str, Source]:
    """Return the tables that play roles, by role."""
    sources: dict[str, Source] = {}
    for finding in find_roles(str(log.path), log.channels, config):
        if finding.role in PROPOSED and finding.sources:
            first = finding.sources[0]
            if first.channels[0].encoding == TABLE:
                sources[finding.role] = first
    return sources


def _rate_setting(role: str, source: Source, time_ns: TimeNs) -> Iterator[Setting]:
    """Propose the rate of a table whose times are stretched."""
    if source.stamp != LOG_TIME:
        return
    rate_hz = stretched_rate_hz(time_ns)
    if rate_hz is None:
        return
    count = len(time_ns)
    end_s = float(time_ns[-1]) / NS_PER_S
    text = (
        f"{source.topic}: its clock is {100.0 / (count - 1):.2g} % too slow: {count} rows in equal steps end "
        f"at {end_s:g} s; at {rate_hz:g} Hz they end a step earlier"
    )
    yield Setting(f"{role}.stamp", f"{rate_hz:g} Hz", text)


def _offset_settings(
    log: Recording, sources: Mapping[str, Source], config: Config
) -> Iterator[Setting]:
    """Propose the offsets of reference and DVL from the IMU: the attitude shows one, the velocities the other."""
    columns = RoleColumns(str(log.path), config)
    for finding in find_roles(str(log.path), log.channels, config):
        if finding.role in sources:
            with suppress(UserError):  # whoever replays reports it
                columns.decode(finding.role, read_tables(log, finding.sources))
    imu = columns.imu
    reference = columns.reference
    if imu is None or reference is None or "reference" not in sources:
        return
    by_attitude_s = _best_offset_s(lambda offset_s: _attitude_misfit(imu, reference, offset_s))
    if by_attitude_s is None:
        return
    why = "the tables have no common clock"
    if abs(by_attitude_s) > LEAST_S:
        text = f"{sources['reference'].topic}: {why}; its attitude fits the gyros {by_attitude_s:+.2f} s later"
        latency_s = round(config.reference.latency_s - by_attitude_s, 3)
        yield Setting("reference.latency_s", latency_s, text)
    if "dvl" not in sources or not len(columns.dvl.time_ns) or not reference.has_attitude:
        return
    by_velocity_s = _velocity_offset_s(imu, columns.dvl, reference, by_attitude_s)
    if by_velocity_s is not None and abs(by_velocity_s) > LEAST_S:
        text = f"{sources['dvl'].topic}: {why}; its velocities fit reference and gyros {by_velocity_s:+.2f} s later"
        latency_s = round(config.dvl.latency_s - by_velocity_s, 3)
        yield Setting("dvl.latency_s", latency_s, text)


def _velocity_offset_s(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns, reference_later_s: float
) -> float | None:
    """Return how much later the pings fit the velocities of the reference; None where nothing shows it."""
    at_s = seconds(reference.time_ns, imu.time_ns[0]) + reference_later_s
    velocity_b = np.einsum("kji,kj->ki", reference.mat_nb, reference.velocity_n)
    return _best_offset_s(lambda offset_s: _velocity_misfit(imu, dvl, at_s, velocity_b, offset_s))


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
    offset_s = float(offsets_s[best])
    if curve > 0.0:
        offset_s += float(0.5 * STEP_S * (before - after) / curve)
    return offset_s


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
