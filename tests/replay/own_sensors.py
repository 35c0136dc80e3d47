"""Measurements of a user's own, as `test_own_measurement` names them."""

import math

import numpy as np

from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.nav.own_measurement import OwnMeasurement, OwnReadings

SD_MPS = 0.02
NORTH_M, EAST_M = 6_354_134.0, 5_366_506.0
"""Metres of a radian of latitude and of longitude, at 32.8 deg north."""


class Speed(OwnMeasurement):
    """The speed over ground, as a log would measure it."""

    name, unit = "speed", "m/s"

    def readings(self, dive: Dive) -> OwnReadings:
        """Take it from the exact motion, with noise."""
        assert dive.reference is not None
        speed = np.linalg.norm(dive.reference.velocity_n, axis=1)
        noise = SD_MPS * np.random.default_rng(3).standard_normal(len(speed))
        return OwnReadings(dive.reference.time_ns, (speed + noise)[:, None], np.array([SD_MPS]))

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write |v|, and v / |v|."""
        z[0] = math.sqrt(ins[3] ** 2 + ins[4] ** 2 + ins[5] ** 2)
        for i in range(3):
            H[0, i] = ins[3 + i] / z[0]


BEACON = (math.radians(32.801), math.radians(34.903), -60.0)
RANGE_SD_M = 0.5


class Range(OwnMeasurement):
    """How far a beacon on the seabed is, by a topic of the log."""

    name, unit = "range", "m"

    def readings(self, dive: Dive) -> OwnReadings:
        """Take the numbers of the topic."""
        beacon = dive.topics["beacon"]
        return OwnReadings(beacon.time_ns, beacon.values, np.array([RANGE_SD_M]))

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write the way to the beacon, and its direction."""
        north = (ins[0] - BEACON[0]) * NORTH_M
        east = (ins[1] - BEACON[1]) * EAST_M
        down = BEACON[2] - ins[2]
        z[0] = math.sqrt(north**2 + east**2 + down**2)
        H[0, 12], H[0, 13], H[0, 14] = north / z[0], east / z[0], down / z[0]


class PlainSpeed(Speed):
    """The same by what no compiler knows."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write |v|, and v / |v|."""
        velocity = {"n": ins[3], "e": ins[4], "d": ins[5]}
        z[0] = math.sqrt(sum(component**2 for component in velocity.values()))
        H[0, :3] = np.array(list(velocity.values())) / z[0]


class Three(OwnMeasurement):
    """A word that would be an axis."""

    name, unit = "three_x", "m"


class Late(Speed):
    """Readings of another day."""

    def readings(self, dive: Dive) -> OwnReadings:
        """Shift the times."""
        found = super().readings(dive)
        return OwnReadings(found.time_ns + 86_400_000_000_000, found.values, found.sd)


class Flat(Speed):
    """Readings without their second axis."""

    def readings(self, dive: Dive) -> OwnReadings:
        """Flatten them."""
        found = super().readings(dive)
        return OwnReadings(found.time_ns, found.values[:, 0], found.sd)


NOT_A_CLASS = 3
