"""Tracks, and what trajectories of them err by, written as TUM files whose errors are known exactly.

A dive is a drawn course on a grid of a tenth of a second. An estimate is the true motion and an error, drawn by one of
several kinds and scaled to a horizontal position error that is asked for. So the ratio of two estimates of a dive is
known before any file is written. Axes are those of TUM files: east, north, up, and a body of forward, left, up.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from sea_worlds import Voyage, drawn_motion

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, vector_from_mat

GRID_S: Final = 0.1
VOYAGE: Final = Voyage(1.4, 0.15, 50.0, 70.0)
EPOCH_S: Final = 1_700_000_000.0
ENU_OF_NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_OF_FLU: Final = np.diag([1.0, -1.0, -1.0])
ERROR_SHARE: Final = 0.005
"""Of the distance travelled: the usual size of a position error, rms over a dive."""
TILTS: Final = (0.1, 0.1, 1.0)
"""Sizes of errors of roll, pitch and heading."""


# --- The true motion.


class Track(NamedTuple):
    """The true motion of one dive, on a grid that begins at 0 s."""

    position_m: Floats  # (k, 3), east, north, up, from the start
    mat: Floats  # (k, 3, 3), from the body to east, north, up

    @property
    def time_s(self) -> Floats:
        """Times of the grid, shape (k,)."""
        return np.asarray(GRID_S * np.arange(len(self.position_m)), np.float64)

    @property
    def distance_m(self) -> float:
        """Length of the horizontal track."""
        steps_m = np.diff(self.position_m[:, :2], axis=0)
        return float(np.sum(np.hypot(steps_m[:, 0], steps_m[:, 1])))


def drawn_track(duration_s: float, rng: np.random.Generator) -> Track:
    """Draw a course and follow it."""
    motion = drawn_motion(VOYAGE, duration_s, rng)
    time_s = np.arange(0.0, duration_s + 0.5 * GRID_S, GRID_S)
    mat_nb = mat_from_rpy(motion.rpy(time_s))
    velocity_n = np.einsum("kij,kj->ki", mat_nb, motion.velocity_b(time_s))
    steps_m = 0.5 * GRID_S * (velocity_n[1:] + velocity_n[:-1])
    moved_m = np.vstack([np.zeros(3), np.cumsum(steps_m, axis=0)])
    return Track(moved_m @ ENU_OF_NED.T, ENU_OF_NED @ mat_nb @ FRD_OF_FLU)


# --- Errors.


class Error(NamedTuple):
    """What an estimate is off by, on the grid of its track."""

    position_m: Floats  # (k, 3), east, north, up
    turn_rad: Floats  # (k, 3), about east, north, up

    def times(self, factor: float) -> "Error":
        """Make all errors larger by a factor."""
        return Error(factor * self.position_m, factor * self.turn_rad)

    def plus(self, other: "Error") -> "Error":
        """Add the errors of another cause."""
        return Error(self.position_m + other.position_m, self.turn_rad + other.turn_rad)

    @property
    def rms_m(self) -> float:
        """Horizontal position error over the dive."""
        return rms_m(self.position_m)


def rms_m(position_error_m: Floats) -> float:
    """Return the root mean square of horizontal errors, shape (k, 2 or 3)."""
    horizontal_m = position_error_m[:, :2]
    return float(np.sqrt(np.mean(np.sum(horizontal_m**2, axis=1))))


Kind = Callable[[Track, np.random.Generator], Error]
"""Draws an error; its size does not matter, unless sizes are to scatter as they do."""


def velocity_walk(track: Track, rng: np.random.Generator) -> Error:
    """Draw a velocity error that walks, as of an unaided filter: the position error grows with time^1.5."""
    velocity = np.cumsum(rng.standard_normal(track.position_m.shape), axis=0)
    return _with_turn(np.cumsum(velocity, axis=0), track, rng)


def position_walk(track: Track, rng: np.random.Generator) -> Error:
    """Draw a white velocity error, as of pings of a DVL: the position error grows with the root of time."""
    steps = rng.standard_normal(track.position_m.shape)
    return _with_turn(np.cumsum(steps, axis=0), track, rng)


def heading_bias(track: Track, rng: np.random.Generator) -> Error:
    """Draw a heading that is off by a constant: the error is across the displacement from the start."""
    bias_rad = rng.standard_normal()
    east_m = track.position_m[:, 0]
    north_m = track.position_m[:, 1]
    across_m = np.column_stack([-north_m, east_m, np.zeros_like(east_m)])
    turn_rad = np.zeros_like(across_m)
    turn_rad[:, 2] = bias_rad
    return Error(bias_rad * across_m, turn_rad)


def start_offset(track: Track, rng: np.random.Generator) -> Error:
    """Draw a start that is off by a constant, and a walk of a fifth of it."""
    offset_m = rng.standard_normal(3)
    walk = position_walk(track, rng)
    size_m = 0.2 * float(np.hypot(offset_m[0], offset_m[1]))
    walk = walk.times(size_m / walk.rms_m)
    return Error(walk.position_m + offset_m, walk.turn_rad)


def scale_error(track: Track, rng: np.random.Generator) -> Error:
    """Draw a scale of the velocity that is off: the error is along the displacement from the start."""
    return _with_turn(rng.standard_normal() * track.position_m, track, rng)


def late_stamps(track: Track, rng: np.random.Generator) -> Error:
    """Draw a delay: the estimate is where the vehicle was some time before."""
    steps = int(rng.integers(2, 8))
    then = np.maximum(np.arange(len(track.position_m)) - steps, 0)
    turn_rad = vector_from_mat(track.mat[then] @ np.swapaxes(track.mat, 1, 2))
    return Error(track.position_m[then] - track.position_m, turn_rad)


def _with_turn(position_m: Floats, track: Track, rng: np.random.Generator) -> Error:
    """Add an attitude error that walks; its heading is off by the share of the distance that the position is."""
    walk = np.cumsum(rng.standard_normal(position_m.shape), axis=0)
    heading_rad = rms_m(position_m) / track.distance_m
    walk *= heading_rad / np.sqrt(np.mean(walk[:, 2] ** 2))
    return Error(position_m, walk * TILTS)


KINDS: Final[dict[str, Kind]] = {
    "velocity walk": velocity_walk,
    "position walk": position_walk,
    "heading bias": heading_bias,
    "start offset": start_offset,
    "scale": scale_error,
    "late stamps": late_stamps,
}


# --- Files.


@dataclass(frozen=True)
class Sampling:
    """When a file has rows, and by which clock."""

    rate_hz: float = 4.0
    phase_s: float = 0.0  # of the first row
    end_share: float = 1.0  # of the dive, after which there are no more rows
    hole: tuple[float, float] | None = (
        None  # a part of the dive without rows, from one share to another
    )
    clock_s: float = EPOCH_S  # of the file at the start of the dive
    clock_ppm: float = 0.0  # by which the clock of the file is fast

    def times_s(self, track: Track) -> Floats:
        """Return the times of the rows since the start of the dive."""
        whole_s = float(track.time_s[-1])
        times_s = np.arange(self.phase_s, whole_s * self.end_share + 1e-9, 1.0 / self.rate_hz)
        if self.hole is None:
            return times_s
        begin, end = self.hole
        inside = (times_s > begin * whole_s) & (times_s < end * whole_s)
        return times_s[~inside]

    def stamps_s(self, times_s: Floats) -> Floats:
        """Stamp the times of rows by the clock of the file."""
        return np.asarray(self.clock_s + times_s * (1.0 + 1e-6 * self.clock_ppm))


def write_tum(
    path: Path,
    track: Track,
    error: Error | None,
    sampling: Sampling,
    noise_m: float = 0.0,
    rng: np.random.Generator | None = None,
) -> None:
    """Write a trajectory: the truth where there is no error, with white noise of the position if asked."""
    times_s, position_m, quaternions = _rows(track, error, sampling)
    if noise_m and rng is not None:
        position_m = position_m + noise_m * rng.standard_normal(position_m.shape)
    stamps_s = sampling.stamps_s(times_s)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack([stamps_s, position_m, quaternions]), fmt="%.9f")


def write_noisy_csv(
    path: Path, track: Track, sampling: Sampling, noise_m: float, rng: np.random.Generator
) -> None:
    """Write the truth with white noise of the position as a table that states the standard deviation."""
    times_s, position_m, quaternions = _rows(track, None, sampling)
    position_m = position_m + noise_m * rng.standard_normal(position_m.shape)
    sd_m = np.full(position_m.shape, noise_m)
    columns = [sampling.stamps_s(times_s), position_m, quaternions, sd_m]
    path.parent.mkdir(parents=True, exist_ok=True)
    header = "time_s,x,y,z,qx,qy,qz,qw,x_sd,y_sd,z_sd"
    np.savetxt(
        path, np.column_stack(columns), fmt="%.9f", delimiter=",", header=header, comments=""
    )


def _rows(track: Track, error: Error | None, sampling: Sampling) -> tuple[Floats, Floats, Floats]:
    """Return times since the start, positions and attitudes of the rows of a file."""
    times_s = sampling.times_s(track)
    position_m = track.position_m
    mat = track.mat
    if error is not None:
        position_m = position_m + error.position_m
        mat = mat_from_vector(error.turn_rad) @ mat
    return times_s, at_times(position_m, times_s), _quaternions_at(mat, times_s)


def at_times(columns: Floats, times_s: Floats) -> Floats:
    """Interpolate columns of the grid, shape (k, n)."""
    grid_s = GRID_S * np.arange(len(columns))
    return np.column_stack([np.interp(times_s, grid_s, column) for column in columns.T])


def _quaternions_at(mat: Floats, times_s: Floats) -> Floats:
    """Interpolate attitudes of the grid, and give them as x, y, z, w, shape (k, 4)."""
    quaternions = Rotation.from_matrix(mat).as_quat()
    # Neighbours have the same sign, so that what lies between them is an attitude.
    turns_over = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    signs = np.append(1.0, np.where(turns_over, -1.0, 1.0)).cumprod()
    between = at_times(quaternions * signs[:, None], times_s)
    lengths = np.linalg.norm(between, axis=1, keepdims=True)
    return np.asarray(between / lengths)
