"""BeamsNetV2 as a user-defined measurement: a network that finds the velocity from four pings of the beams.

N. Cohen and I. Klein, "BeamsNet: A data-driven approach enhancing Doppler velocity log measurements for autonomous
underwater vehicle navigation", 2022. The weights that the authors publish are named in ``BEAMSNET_WEIGHTS``. The file
is a zip of numbers, which needs neither torch nor pickle. ``BEAMSNET_ARM_M`` is the lever arm of the vehicle.
"""

import os
import zipfile

import numpy as np

from insdvl_replay import UserMeasurement, UserReadings

SD_MPS = 0.03
ARM_X, ARM_Y, ARM_Z = map(
    float, os.environ.get("BEAMSNET_ARM_M", "0,0,0").split(",")
)  # IMU to DVL, of your vehicle
SHAPES = ((6, 3, 2), (6,), (16, 18), (16,), (2, 16), (2,), (3, 6), (3,))
YAW, TILT = np.deg2rad([45.0, 135.0, 225.0, 315.0]), np.deg2rad(20.0)
BEAMS = np.column_stack(
    [np.cos(YAW) * np.sin(TILT), np.sin(YAW) * np.sin(TILT), np.full(4, np.cos(TILT))]
)


def load_weights(path):
    """Return the weights of all layers, from torch's file."""
    with zipfile.ZipFile(path) as file:
        data = [np.frombuffer(file.read(f"archive/data/{i}"), "<f4") for i in range(len(SHAPES))]
    return [
        numbers.reshape(shape).astype(float) for numbers, shape in zip(data, SHAPES, strict=True)
    ]


def velocity(weights, beams):
    """Return velocities, shape (k - 3, 3), of beams, shape (k, 4): each from a ping and the three before it."""
    kernel, kernel_bias, first, first_bias, second, second_bias, last, last_bias = weights
    past = np.stack([beams[i : len(beams) - 3 + i] for i in range(3)], axis=1)
    pairs = np.stack([past[:, :, :3], past[:, :, 1:]], axis=-1)  # neighbouring beams
    features = np.tanh(np.einsum("kcbi,oci->kob", pairs, kernel) + kernel_bias[:, None]).reshape(
        len(past), 18
    )
    features = np.maximum(features @ first.T + first_bias, 0.0)
    features = np.maximum(features @ second.T + second_bias, 0.0)
    return np.column_stack([beams[3:], features]) @ last.T + last_bias


class BeamsNet(UserMeasurement):
    """The network's velocity of the DVL, in the axes of the IMU."""

    name, unit = "beamsnet", "m/s"

    def readings(self, dive):
        """Return a velocity for each ping with four beams, and with three such pings before it."""
        if dive.dvl.beam_velocity_mps is None:
            raise ValueError("the DVL has no single beams")
        weights = load_weights(os.environ["BEAMSNET_WEIGHTS"])
        whole = np.isfinite(dive.dvl.beam_velocity_mps).all(axis=1)
        time_ns, measured = dive.dvl.time_ns[whole], dive.dvl.beam_velocity_mps[whole]
        # The beams of the network's DVL, whatever those of this one are.
        beams = measured @ np.linalg.pinv(dive.dvl.beam_vectors_d).T @ BEAMS.T
        step_s = np.diff(time_ns) * 1e-9
        usual = step_s < 1.5 * np.median(step_s)
        follows = usual[:-2] & usual[1:-1] & usual[2:]
        return UserReadings(time_ns[3:][follows], velocity(weights, beams)[follows], SD_MPS)

    @staticmethod
    def predict(ins, z, H):
        """Write C' v + w x l and its Jacobian, [C' | C' [v x] | 0 | -[l x]]."""
        for i in range(3):
            north, east, down = ins[6 + i], ins[9 + i], ins[12 + i]
            z[i] = north * ins[3] + east * ins[4] + down * ins[5]
            H[i, 0], H[i, 1], H[i, 2] = north, east, down
            H[i, 3] = east * ins[5] - down * ins[4]
            H[i, 4] = down * ins[3] - north * ins[5]
            H[i, 5] = north * ins[4] - east * ins[3]
        z[0] += ins[19] * ARM_Z - ins[20] * ARM_Y
        z[1] += ins[20] * ARM_X - ins[18] * ARM_Z
        z[2] += ins[18] * ARM_Y - ins[19] * ARM_X
        H[0, 10], H[0, 11] = ARM_Z, -ARM_Y
        H[1, 9], H[1, 11] = -ARM_Z, ARM_X
        H[2, 9], H[2, 10] = ARM_Y, -ARM_X
