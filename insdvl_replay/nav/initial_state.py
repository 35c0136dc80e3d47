"""What a filter starts from, and how its errors hang together."""

from dataclasses import dataclass, field, replace

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.levelling import Level


@dataclass(frozen=True)
class Start:
    """Where a filter starts and how sure it is.

    Attributes
    ----------
    position : ndarray, shape (3,)
        Latitude rad, longitude rad, height m.
    velocity_n : ndarray, shape (3,)
        m/s
    mat_nb : ndarray, shape (3, 3)
        Attitude.
    cov : ndarray, shape (12, 12)
        Covariance of the error states, SI units.
    accel_bias_b, gyro_bias_b : ndarray, shape (3,)
        Biases that are known beforehand, m/s^2 and rad/s; zero unless given.
    constants : ndarray, shape (c,)
        Of the sensors, that have states of their own.
    is_heading_sensed : bool
        The heading is that of the sensor, and has its bias.
    """

    position: Floats
    velocity_n: Floats
    mat_nb: Floats
    cov: Floats
    accel_bias_b: Floats = field(default_factory=lambda: np.zeros(3))
    gyro_bias_b: Floats = field(default_factory=lambda: np.zeros(3))
    constants: Floats = field(default_factory=lambda: np.zeros(0))
    is_heading_sensed: bool = False

    @property
    def sd(self) -> Floats:
        """Standard deviations of the error states, shape (12,)."""
        return np.sqrt(np.diagonal(self.cov))


def with_more_states(start: Start, more_sd: Floats, constants: int, *, heading_bias: bool = False) -> Start:
    """Let a start be of more states, independent of all others but for the bias of a heading that was the sensor's.

    Parameters
    ----------
    more_sd : ndarray, shape (n - 12,)
        Their standard deviations.
    constants : int
        How many of them are constants of the sensors, which are taken to be zero.
    heading_bias : bool
        Whether the last of them is that bias.
    """
    if not len(more_sd):
        return start
    n, cov = len(start.cov), np.diag(np.concatenate([start.sd, more_sd]) ** 2)
    cov[:n, :n] = start.cov
    if heading_bias and start.is_heading_sensed:
        by_heading = np.append(start.cov[:, PHI.stop - 1] / start.cov[PHI.stop - 1, PHI.stop - 1], 1.0)
        rows = [*range(n), len(cov) - 1]
        cov[len(cov) - 1, len(cov) - 1] = 0.0
        cov[np.ix_(rows, rows)] += more_sd[-1] ** 2 * np.outer(by_heading, by_heading)
    return replace(start, cov=cov, constants=np.zeros(constants))


def start_cov(sd: Floats, mat_nb: Floats, level: Level | None, velocity_by_dvl_n: Floats | None) -> Floats:
    """Return the covariance of a start from the errors that do not depend on each other.

    Accelerometers that are biased tilt the level by exactly ``phi = (-b_e, b_n) / g``, and a velocity that the DVL
    measures in b is off by ``phi x v`` in n: what the filter finds of one it finds of the other.

    Parameters
    ----------
    sd : ndarray, shape (12,)
        Of the error states where each is known by itself.
    mat_nb : ndarray, shape (3, 3)
        Attitude at the start.
    level : Level or None
        Where it made roll and pitch, whose standard deviations then follow from it.
    velocity_by_dvl_n : ndarray, shape (3,), or None
        The velocity, where the DVL's was turned to n.

    Returns
    -------
    ndarray, shape (12, 12)
    """
    effect, own = np.eye(len(sd)), np.diag(sd**2)
    if level is not None:
        tilt = slice(PHI.start, PHI.start + 2)
        # C_hat' e_d is gravity's direction in b, so that phi x e_d = -C times its error.
        per_gravity = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) @ mat_nb / np.linalg.norm(level.gravity_b)
        effect[tilt, BA] = per_gravity @ level.per_accel_bias
        effect[tilt, BG] = per_gravity @ level.per_gyro_bias
        own[tilt, tilt] = per_gravity @ level.noise_cov_b @ per_gravity.T
    if velocity_by_dvl_n is not None:
        effect[DV] += -skew(velocity_by_dvl_n) @ effect[PHI]
    cov: Floats = effect @ own @ effect.T
    return 0.5 * (cov + cov.T)
