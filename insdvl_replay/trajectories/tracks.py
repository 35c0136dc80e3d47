"""Trajectories as tracks in metres north, east, down, at the times at which they are compared."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ImuColumns,
    Mask,
    ReferenceColumns,
    SolutionColumns,
    TimeNs,
    in_blocks,
    nothing,
)
from insdvl_replay.core.errors import LogError, Note, counted
from insdvl_replay.core.history import History
from insdvl_replay.core.states import BA, POSITION, states_with
from insdvl_replay.evaluation.pose_errors import Poses
from insdvl_replay.evaluation.track_alignment import (
    UNCHANGED,
    Align,
    NoAlignmentError,
    TrackTransform,
    aligned,
)
from insdvl_replay.geometry.frames import moved_position, north_east_down_m
from insdvl_replay.logs.trajectory import Axes, read_trajectory
from insdvl_replay.preparation.solutions import interpolated, interpolated_attitude
from insdvl_replay.trajectories.files import RunFile

STATES: Final = states_with(["position"])
_REPORTED: Final = np.r_[: BA.start, POSITION.start : POSITION.stop]
FEWEST_POSES: Final = 3
_MOST_COVARIANCES: Final = 5_000  # at which NEES is judged, of one run
# A track with its axes exchanged is right if it misses by so much less, in shares of the size of the track.
_FAR_OFF: Final = 0.5
_NEAR: Final = 0.2
_FAR_START: Final = 0.2  # share of the size of the track, its standard deviation
_FIRST: Final = 10  # poses whose median is the begin of a track
_SAME_SHARE: Final = 0.5  # more equal poses are no chance
_FEWEST_SAME: Final = 10
_OTHER_AXES: Final[dict[Axes, Axes]] = {"enu_flu": "ned_frd", "ned_frd": "enu_flu"}


@dataclass(frozen=True)
class Track:
    """A trajectory as it was read."""

    path: Path
    columns: SolutionColumns
    ned_m: Floats  # (k, 3), from the origin of its file, or of all geographic positions; NaN where unknown
    is_placed: bool  # whether its positions are geographic
    notes: tuple[Note, ...] = ()

    @property
    def time_ns(self) -> TimeNs:
        """Its times, (k,)."""
        return self.columns.motion.time_ns

    @property
    def mat_nb(self) -> Floats:
        """Its attitudes, (k, 3, 3)."""
        return self.columns.motion.mat_nb

    @property
    def has_position(self) -> bool:
        """Whether any pose has a position."""
        return bool(np.isfinite(self.ned_m[:, :2]).all(axis=1).any())

    @property
    def known(self) -> Mask:
        """The poses with a position, (k,), or with an attitude if there is no position."""
        located = np.asarray(np.isfinite(self.ned_m[:, :2]).all(axis=1))
        if located.any():
            return located
        return self.columns.motion.known["attitudes"]

    @property
    def known_ns(self) -> TimeNs:
        """The times of these poses."""
        return self.time_ns[self.known]

    @property
    def has_covariance(self) -> bool:
        """Whether it says how uncertain it is."""
        return bool(np.isfinite(self.columns.cov).any())

    def poses(self) -> Poses:
        """Return the poses that have a whole position."""
        rows = np.flatnonzero(np.isfinite(self.ned_m).all(axis=1))
        return Poses(self.time_ns, self.ned_m, self.mat_nb).rows(rows)


def read_tracks(files: Sequence[RunFile], axes: Sequence[Axes | None]) -> list[Track]:
    """Read trajectories of one dive; geographic positions become metres from the first of them.

    A LogError names the file that cannot be used.
    """
    read = list[tuple[RunFile, SolutionColumns, list[Note]]]()
    for file, own_axes in zip(files, axes, strict=True):
        columns, notes = read_trajectory(file.path, file.topic, own_axes)
        read.append((file, columns, notes))
    origin = _first_position([columns for _, columns, _ in read])
    tracks = list[Track]()
    for file, columns, notes in read:
        is_placed = columns.moved_n is None
        ned_m = columns.moved_n
        if ned_m is None:
            ned_m = _from_origin(columns.motion.position, origin)
        tracks.append(Track(file.path, columns, ned_m, is_placed, tuple(notes)))
    for track in tracks:
        if np.count_nonzero(track.known) < FEWEST_POSES:
            poses = counted(int(np.count_nonzero(track.known)), "pose")
            text = f"has {poses}, and a comparison needs {FEWEST_POSES}"
            raise LogError(text, "check whether the file is whole", track.path)
    return tracks


def _first_position(read: Sequence[SolutionColumns]) -> Floats:
    """Return the first geographic position of any trajectory, shape (3,); zeros if there is none."""
    for columns in read:
        known = columns.motion.known["positions"]
        if columns.moved_n is None and known.any():
            first = columns.motion.position[int(np.argmax(known))]
            return np.asarray(np.nan_to_num(first))
    return np.zeros(3)


def _from_origin(position: Floats, origin: Floats) -> Floats:
    def offset(rows: Floats) -> Floats:
        return north_east_down_m(rows, np.broadcast_to(origin, rows.shape))

    return in_blocks(offset, position, np.empty(position.shape))


# --- Times at which they are compared.


def common_times(truth: Track, runs: Sequence[Track]) -> TimeNs:
    """Return the times of the sparsest trajectory at which all of them may be known; a LogError if there are none."""
    for run in runs:
        _require_overlap(truth, run)
    tracks = [truth, *runs]
    start_ns = max(int(track.known_ns[0]) for track in tracks)
    end_ns = min(int(track.known_ns[-1]) for track in tracks)
    steps_ns = [float(np.median(np.diff(track.known_ns))) for track in tracks]
    sparsest = tracks[int(np.argmax(steps_ns))].known_ns
    inside = sparsest[(sparsest >= start_ns) & (sparsest <= end_ns)]
    if len(inside) < FEWEST_POSES:
        names = " and ".join(str(run.path) for run in runs)
        text = f"{names} and the reference have {max(len(inside), 0)} poses in a common time"
        raise LogError(text, "they must be known at the same time", truth.path)
    return inside


def _require_overlap(truth: Track, run: Track) -> None:
    """Raise a LogError if a run and the reference are of different times."""
    first_ns = int(run.known_ns[0])
    last_ns = int(run.known_ns[-1])
    since_ns = int(truth.known_ns[0])
    until_ns = int(truth.known_ns[-1])
    if first_ns <= until_ns and last_ns >= since_ns:
        return
    spans = (
        f"has times {first_ns / NS_PER_S:.3f} .. {last_ns / NS_PER_S:.3f} s, and the reference "
        f"{since_ns / NS_PER_S:.3f} .. {until_ns / NS_PER_S:.3f} s"
    )
    apart_s = (first_ns - since_ns) / NS_PER_S
    hint = f"their clocks differ by {_duration(abs(apart_s))}: write both with one clock"
    raise LogError(f"{spans}: nothing in common", hint, run.path)


def _duration(time_s: float) -> str:
    """Write a length of time; whole hours are those of a time zone."""
    hours = time_s / 3600.0
    if hours >= 1.0 and abs(hours - round(hours)) < 0.01:
        return f"{hours:.0f} h (a time zone?)"
    return f"{time_s:.0f} s"


def require_other_than_truth(truth: Track, run: Track) -> None:
    """Raise a LogError if most poses of a run are those of the reference."""
    _, ours, theirs = np.intersect1d(run.time_ns, truth.time_ns, return_indices=True)
    own = run.ned_m[ours]
    others = truth.ned_m[theirs]
    if not run.has_position:
        own = run.mat_nb[ours].reshape(-1, 9)
        others = truth.mat_nb[theirs].reshape(-1, 9)
    same = (own == others).all(axis=1)
    count = 0
    if same.any() and np.ptp(own[same], axis=0).any():
        # Of a vehicle at rest, both say the same.
        count = int(np.count_nonzero(same))
    if count >= _FEWEST_SAME and count > _SAME_SHARE * len(run.time_ns):
        text = f"has the poses of the reference {truth.path} in {count} of {len(run.time_ns)} rows"
        raise LogError(f"{text}: its error would be 0", "name another reference", run.path)


# --- At these times.


@dataclass(frozen=True)
class Placed:
    """A trajectory at the common times, in the frame of the reference."""

    track: Track
    ned_m: Floats  # (k, 3)
    mat_nb: Floats  # (k, 3, 3)
    velocity_n: Floats  # (k, 3), m/s
    transform: TrackTransform = UNCHANGED


def at_times(track: Track, time_ns: TimeNs) -> Placed:
    """Interpolate a trajectory."""
    motion = track.columns.motion
    velocity_n = nothing((len(time_ns), 3))
    if motion.has_velocity:
        velocity_n = interpolated(motion.time_ns, motion.velocity_n, time_ns)
    mat_nb = nothing((len(time_ns), 3, 3))
    if motion.has_attitude:
        mat_nb = interpolated_attitude(motion.time_ns, motion.mat_nb, time_ns)
    ned_m = interpolated(motion.time_ns, track.ned_m, time_ns)
    return Placed(track, ned_m, mat_nb, velocity_n)


def in_frame_of(truth: Placed, run: Placed, align: Align, axes: Axes | None) -> Placed:
    """Bring a run into the frame of the reference, by the alignment that was asked for.

    Positions from another origin begin where the reference does. A LogError if its axes are exchanged, or if the
    alignment cannot be found.
    """
    if run.track.is_placed != truth.track.is_placed:
        shift_m = _start_shift(truth, run)
        run = replace(run, ned_m=run.ned_m + shift_m)
    _require_same_axes(truth, run, axes)
    if align == Align.NONE:
        return run
    try:
        transform = aligned(*_both_heights(run.ned_m, truth.ned_m), align)
    except NoAlignmentError as error:
        text = f"cannot be aligned with the reference by {align}: the track is a line or a point"
        raise LogError(text, "--align none", run.track.path) from error
    return replace(
        run,
        ned_m=transform.moved(run.ned_m),
        mat_nb=transform.mat @ run.mat_nb,
        velocity_n=transform.scale * run.velocity_n @ transform.mat.T,
        transform=transform,
    )


def _start_shift(truth: Placed, run: Placed) -> Floats:
    """Return what moves a run to the first position that both have, shape (3,)."""
    off_m = truth.ned_m - run.ned_m
    known = np.isfinite(off_m[:, :2]).all(axis=1)
    if not known.any():
        return np.zeros(3)
    return np.asarray(np.nan_to_num(off_m[int(np.argmax(known))]))


def _both_heights(track_m: Floats, reference_m: Floats) -> tuple[Floats, Floats]:
    """Return tracks with heights of zero where one of them has none at all."""
    if np.isfinite(track_m[:, 2]).any() and np.isfinite(reference_m[:, 2]).any():
        return track_m, reference_m
    level = [1.0, 1.0, 0.0]
    return np.nan_to_num(track_m * level, nan=np.nan), np.where(
        np.isfinite(reference_m), reference_m, 0.0
    ) * level


def _require_same_axes(truth: Placed, run: Placed, axes: Axes | None) -> None:
    """Raise a LogError if the track is that of the reference once north and east are exchanged."""
    if run.track.is_placed or truth.track.is_placed:
        return
    known = np.isfinite(truth.ned_m[:, :2]).all(axis=1) & np.isfinite(run.ned_m[:, :2]).all(axis=1)
    if np.count_nonzero(known) < FEWEST_POSES:
        return
    reference_m = truth.ned_m[known, :2]
    reference_m = reference_m - reference_m[0]
    track_m = run.ned_m[known, :2]
    track_m = track_m - track_m[0]
    size = float(np.linalg.norm(reference_m - reference_m.mean(axis=0)))
    as_read = float(np.linalg.norm(track_m - reference_m))
    exchanged = float(np.linalg.norm(track_m[:, ::-1] - reference_m))
    if as_read > _FAR_OFF * size and exchanged < _NEAR * size:
        other = _OTHER_AXES[axes or "enu_flu"]
        text = "follows the reference once north and east are exchanged: its axes are others"
        raise LogError(text, f"--axes {other}, or --reference-axes {other}", run.track.path)


def position_of(ned_m: Floats) -> Floats:
    """Return geographic positions of metres from a point on the equator, shape (k, 3)."""

    def placed(rows: Floats) -> Floats:
        return moved_position(np.zeros(rows.shape), rows)

    return in_blocks(placed, ned_m, np.empty(ned_m.shape))


def history_of(name: str, placed: Placed, time_ns: TimeNs) -> History:
    """Return a trajectory as the history of a filter, which reports a part of the states."""
    columns = placed.track.columns
    is_moved = placed.transform is not UNCHANGED
    count = len(time_ns)
    sd = np.asarray(nothing((count, len(STATES))))
    cov_ns = np.empty(0, np.int64)
    cov = np.empty((0, len(STATES), len(STATES)))
    if placed.track.has_covariance and not is_moved:
        last = np.searchsorted(columns.cov_ns, time_ns, side="right") - 1
        last = last.clip(0, None)
        sd = np.full((count, len(STATES)), np.nan)
        variance = np.diagonal(columns.cov, axis1=1, axis2=2)
        with np.errstate(invalid="ignore"):
            sd[:, _REPORTED] = np.sqrt(variance)[last]
        chosen = np.arange(0, count, max(1, -(-count // _MOST_COVARIANCES)))
        cov_ns = time_ns[chosen]
        cov = np.full((len(chosen), len(STATES), len(STATES)), np.nan)
        cov[np.ix_(np.arange(len(chosen)), _REPORTED, _REPORTED)] = columns.cov[last[chosen]]
    return History(
        filter=name,
        time_ns=time_ns,
        updated=np.zeros(count, np.bool_),
        position=position_of(placed.ned_m),
        velocity_n=placed.velocity_n,
        mat_nb=placed.mat_nb,
        accel_bias_b=nothing((count, 3)),
        gyro_bias_b=nothing((count, 3)),
        sd=sd,
        cov_ns=cov_ns,
        cov=cov,
        innovations=(),
        states=STATES,
        is_partial=True,
        has_own_start=True,
    )


def reference_of(placed: Placed, time_ns: TimeNs) -> ReferenceColumns:
    """Return the trajectory that others are compared with."""
    return ReferenceColumns(
        time_ns, position_of(placed.ned_m), placed.velocity_n, np.asarray(placed.mat_nb)
    )


def as_readings(track: Track, start_ns: int, end_ns: int) -> ImuColumns:
    """Return positions of a span as readings, so that copies of a dive are known by the fingerprint of an IMU."""
    inside = (track.time_ns >= start_ns) & (track.time_ns <= end_ns) & track.known
    position_m = np.nan_to_num(track.ned_m[inside])
    axis = np.nan_to_num(track.mat_nb[inside][:, :, 0])
    turned = axis * np.arange(1.0, 4.0)
    return ImuColumns(track.time_ns[inside], position_m, turned)


class Remark(NamedTuple):
    """What is odd about a run; runs of one filter share a note."""

    code: str  # of the note
    value: str = ""  # of this run


def frame_remarks(truth: Placed, run: Placed, align: Align) -> Iterator[Remark]:
    """Yield how a run is in the frame of the reference, and what an alignment leaves out."""
    if align != Align.NONE:
        if run.track.has_covariance:
            yield Remark("trajectory_covariance")
        return
    if not run.track.has_position or not truth.track.has_position:
        return
    if run.track.is_placed != truth.track.is_placed:
        yield Remark("trajectory_origin")
        return
    first_m = truth.ned_m[:, :2] - run.ned_m[:, :2]
    first_m = first_m[np.isfinite(first_m).all(axis=1)][:_FIRST]
    off_m = 0.0
    if len(first_m):
        off_m = float(np.linalg.norm(np.median(first_m, axis=0)))
    located = truth.ned_m[:, :2]
    located = located[np.isfinite(located).all(axis=1)]
    size_m = 0.0
    if len(located):
        size_m = float(np.hypot(*located.std(axis=0)))
    if off_m > _FAR_START * size_m:
        yield Remark("trajectory_start", f"{off_m:.4g} m")


def lacking(run: Track, other: Track) -> list[str]:
    """Name the quantities that a run has not and another one has."""
    ours = run.columns.motion.known
    theirs = other.columns.motion.known
    found = list[str]()
    if other.has_position and not run.has_position:
        found.append("positions")
    if theirs["attitudes"].any() and not ours["attitudes"].any():
        found.append("attitudes")
    return found
