"""Files as instruments write them, of simulated dives: what a writer needs, and how a replay of one is compared.

A test of a format writes the bytes in the published layout from a `Told`, and calls `compare`: the file, with what it
lacks from an MCAP, must give the replay of the MCAP of the same dive, to the resolution of the format.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from insdvl_replay import replay_log
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats, ImuColumns, TimeNs
from insdvl_replay.geometry.frames import beam_vectors, solve_beams
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.sim.dive import simulate_dive


@dataclass(frozen=True)
class Told:
    """What the DVL and the IMU of a dive say.

    Attributes
    ----------
    dive : Dive
        With beams in the directions of the instrument, or without beams.
    time_ns : ndarray
        Of the pings, shape (k,).
    velocity_d : ndarray
        Forward, starboard, down, m/s, shape (k, 3), NaN where fewer than three beams are valid.
    beams_mps : ndarray
        Along the beams, towards the seabed, shape (k, beams), NaN where one is lost.
    """

    dive: Dive
    time_ns: TimeNs
    velocity_d: Floats
    beams_mps: Floats

    def of_velocities(self) -> "Told":
        """The same with a DVL that gives velocities alone; pings without one are left out."""
        known = np.isfinite(self.velocity_d).all(axis=1)
        velocity_d = self.velocity_d[known]
        dvl = DvlColumns(self.time_ns[known], velocity_d=velocity_d)
        dive = replace(self.dive, dvl=dvl)
        return Told(dive, dvl.time_ns, velocity_d, self.beams_mps[known])

    @property
    def is_valid(self) -> list[bool]:
        """Whether each ping has a velocity."""
        found: list[bool] = np.isfinite(self.velocity_d).all(axis=1).tolist()
        return found

    def single(self) -> "Told":
        """The same with velocities and an IMU of 32 bits."""
        imu = self.dive.imu
        single = ImuColumns(
            imu.time_ns, _single(imu.specific_force_b), _single(imu.angular_rate_b)
        )
        velocity_d = _single(self.velocity_d)
        dvl = DvlColumns(self.time_ns, velocity_d=velocity_d)
        return Told(
            replace(self.dive, imu=single, dvl=dvl), self.time_ns, velocity_d, self.beams_mps
        )


def _single(values: Floats) -> Floats:
    """Return numbers as 32 bits hold them."""
    return values.astype(np.float32).astype(np.float64)


@cache
def told(
    tilt_deg: float = 22.5, azimuth_deg: tuple[float, ...] = (135.0, 225.0, 315.0, 45.0)
) -> Told:
    """Simulate a minute with a DVL whose beams point so; a few pings lack beams.

    Azimuths are clockwise from the bow, as the data sheet has them; those of the default are Water Linked's.
    """
    dive = simulate_dive("calibration", seed=4, duration_s=60.0, imu_rate_hz=50.0, dvl_rate_hz=5.0)
    beams, vectors = dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d
    assert beams is not None
    assert vectors is not None
    velocity_d = solve_beams(beams, vectors)[0]
    vectors = beam_vectors(tilt_deg, azimuth_deg)
    # The MCAP has beams of 32 bits.
    beams = (velocity_d @ vectors.T).astype(np.float32).astype(np.float64)
    if len(azimuth_deg) > 3:
        beams[20::37, 1] = np.nan
    beams[30::41, :] = np.nan
    velocity_d[30::41] = np.nan
    time_ns = dive.dvl.time_ns // 100_000 * 100_000
    dvl = DvlColumns(time_ns, beam_velocity_mps=beams, beam_vectors_d=vectors)
    return Told(replace(dive, dvl=dvl), time_ns, velocity_d, beams)


def write_whole(folder: Path, dive: Dive) -> Path:
    """Write the MCAP of a dive."""
    path = folder / "whole" / "dive.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_dive(path, dive)
    return path


def write_rest(folder: Path, dive: Dive, *, imu: bool = True) -> Path:
    """Write the MCAP of a dive without its DVL, or without its IMU, too."""
    path = folder / "rest" / "rest.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    if not imu:
        none = np.empty((0, 3))
        dive = replace(dive, imu=ImuColumns(np.empty(0, np.int64), none, none))
    write_dive(
        path, replace(dive, dvl=DvlColumns(np.empty(0, np.int64), velocity_d=np.empty((0, 3))))
    )
    return path


def assert_same_dvl(found: Dive, expected: Dive, atol_mps: float, atol_ns: int = 0) -> float:
    """Compare the columns of two DVLs; return the largest difference, m/s."""
    np.testing.assert_allclose(found.dvl.time_ns, expected.dvl.time_ns, rtol=0, atol=atol_ns)
    if expected.dvl.beam_velocity_mps is None:
        ours, theirs = found.dvl.velocity_d, expected.dvl.velocity_d
    else:
        ours, theirs = found.dvl.beam_velocity_mps, expected.dvl.beam_velocity_mps
        np.testing.assert_allclose(
            found.dvl.beam_vectors_d, expected.dvl.beam_vectors_d, atol=1e-7
        )
    assert ours is not None
    assert theirs is not None
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=atol_mps)
    return float(np.nanmax(np.abs(ours - theirs)))


def assert_same_replay(
    paths: Sequence[Path], whole: Path, atol_m: float, config: Config | None = None
) -> float:
    """Replay files and the MCAP of the same dive; return the largest difference between their positions, m."""
    found = _positions(paths, config or Config())
    expected = _positions([whole], Config())
    apart_m = np.abs(found - expected)
    assert np.isfinite(expected).all()
    assert apart_m.max() <= atol_m
    return float(apart_m.max())


def _positions(paths: Sequence[Path], config: Config) -> Floats:
    """Replay files with the noise of their sensors, which nothing has to be fitted for; return all positions, m."""
    settings = msgspec.structs.replace(config, noise=load_config("fog").noise)
    frame = replay_log(list(paths), settings).trajectory
    names = ["position_n_m", "position_e_m", "position_d_m"]
    return np.asarray(frame[names].to_numpy())


def compare(
    paths: Sequence[Path],
    dive: Dive,
    folder: Path,
    *,
    atol_mps: float,
    atol_m: float,
    atol_ns: int = 0,
) -> tuple[float, float]:
    """Compare files with the MCAP of the same dive: pings, then positions; return the largest differences."""
    whole = write_whole(folder, dive)
    apart_mps = assert_same_dvl(
        read_dive(paths, Config()), read_dive(whole, Config()), atol_mps, atol_ns
    )
    return apart_mps, assert_same_replay(paths, whole, atol_m)
