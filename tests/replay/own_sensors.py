"""Measurements of a user's own, as `test_own_measurement` names them."""

import math
import sys

import numba
import numpy as np

from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.nav.user_measurement import UserMeasurement, UserReadings

SD_MPS = 0.02
NORTH_M, EAST_M = 6_354_134.0, 5_366_506.0
"""Metres of a radian of latitude and of longitude, at 32.8 deg north."""


class Speed(UserMeasurement):
    """The speed over ground, as a log would measure it."""

    name, unit = "speed", "m/s"

    def readings(self, dive: Dive) -> UserReadings:
        """Take it from the exact motion, with noise."""
        assert dive.reference is not None
        speed = np.linalg.norm(dive.reference.velocity_n, axis=1)
        noise = SD_MPS * np.random.default_rng(3).standard_normal(len(speed))
        return UserReadings(dive.reference.time_ns, (speed + noise)[:, None], np.array([SD_MPS]))

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write |v|, and v / |v|."""
        z[0] = math.sqrt(ins[3] ** 2 + ins[4] ** 2 + ins[5] ** 2)
        for i in range(3):
            H[0, i] = ins[3 + i] / z[0]


class JittedSpeed(Speed):
    """The same, compiled by its author."""

    predict = staticmethod(numba.njit(Speed.predict))


BEACON = (math.radians(32.801), math.radians(34.903), -60.0)
RANGE_SD_M = 0.5


class Range(UserMeasurement):
    """How far a beacon on the seabed is, by a topic of the log."""

    name, unit = "range", "m"

    def readings(self, dive: Dive) -> UserReadings:
        """Take the numbers of the topic."""
        beacon = dive.topics["beacon"]
        return UserReadings(beacon.time_ns, beacon.values, np.array([RANGE_SD_M]))

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


class ImportingSpeed(Speed):
    """The same by a module that it imports itself, which the compiler tells by an error that is none of its own."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write |v|, and v / |v|."""
        import math as own_math

        z[0] = own_math.sqrt(ins[3] ** 2 + ins[4] ** 2 + ins[5] ** 2)
        H[0, :3] = ins[3:6] / z[0]


class Deep(UserMeasurement):
    """What the tool has as ``depth``, with a zero that is known."""

    name, unit = "deep", "m"
    sd = 0.05

    def readings(self, dive: Dive) -> UserReadings:
        """Take those of the pressure gauge."""
        return UserReadings(
            dive.sensors["depth"].time_ns, dive.sensors["depth"].values, np.array([self.sd])
        )

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write -h, which has the downward error of the position."""
        z[0], H[0, 14] = -ins[2], 1.0


class Bow(UserMeasurement):
    """What the tool has as ``heading``, of a vehicle that does not point south."""

    name, unit = "bow", "rad"
    sd = math.radians(1.0)

    def readings(self, dive: Dive) -> UserReadings:
        """Take those of the compass."""
        return UserReadings(
            dive.sensors["heading"].time_ns, dive.sensors["heading"].values, np.array([self.sd])
        )

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write the direction of the first column of C."""
        north, east, down = ins[6], ins[9], ins[12]
        steep = down / (north**2 + east**2)
        z[0] = math.atan2(east, north)
        H[0, 3], H[0, 4], H[0, 5] = -steep * north, -steep * east, 1.0


class PlainBow(Bow):
    """The same by what no compiler knows."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write the direction of the first column of C."""
        Bow.predict(*{"ins": ins, "z": z, "H": H}.values())


class DeepTwice(Deep):
    """Two components."""

    name, unit = "deep_twice", "m"

    def readings(self, dive: Dive) -> UserReadings:
        """Say the depth twice."""
        found = super().readings(dive)
        return UserReadings(found.time_ns, np.repeat(found.values, 2, axis=1), found.sd)

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write -h twice."""
        for i in range(2):
            z[i], H[i, 14] = -ins[2], 1.0


class FirstOfSpeed(Speed):
    """A row of the name that a first component has."""

    name = "speed_c1"


class OtherSpeed(Speed):
    """Another class of the same name."""


class BuiltIn(Speed):
    """The name of a sensor that the tool has."""

    name = "depth"


class Three(UserMeasurement):
    """A word that would be an axis."""

    name, unit = "three_x", "m"


class Late(Speed):
    """Readings of another day."""

    def readings(self, dive: Dive) -> UserReadings:
        """Shift the times."""
        found = super().readings(dive)
        return UserReadings(found.time_ns + 86_400_000_000_000, found.values, found.sd)


class Flat(Speed):
    """Readings without their second axis, each with its own noise."""

    def readings(self, dive: Dive) -> UserReadings:
        """Flatten them."""
        found = super().readings(dive)
        return UserReadings(
            found.time_ns, found.values[:, 0], SD_MPS * (1.0 + np.arange(len(found.values)))
        )


class Uneven(Speed):
    """The same in columns."""

    def readings(self, dive: Dive) -> UserReadings:
        """Have a column of noise."""
        found = super().readings(dive)
        return UserReadings(
            found.time_ns, found.values, SD_MPS * (1.0 + np.arange(len(found.values))[:, None])
        )


NOT_A_CLASS = 3


class Silent(Speed):
    """An instrument that ends early."""

    name = "paddle_wheel"

    def readings(self, dive: Dive) -> UserReadings:
        """Keep the first minute."""
        found = super().readings(dive)
        return UserReadings(found.time_ns[:300], found.values[:300], found.sd)


class NoPrediction(UserMeasurement):
    """A class that forgot its prediction, which compiled code would not tell."""

    name, unit = "forgotten", "m/s"
    readings = Speed.readings


class NoReadings(UserMeasurement):
    """A class that forgot its readings."""

    name, unit = "forgotten", "m/s"
    predict = staticmethod(Speed.predict)


class Bound(Speed):
    """A prediction that is a method."""

    def predict(self, ins: Floats, z: Floats, H: Floats) -> None:  # type: ignore[override]
        """Write |v|."""
        Speed.predict(ins, z, H)


class WithArguments(Speed):
    """A class that nobody can make."""

    def __init__(self, sd: float) -> None:
        self.sd = sd


class OtherTopic(Speed):
    """The name of a topic misspelt."""

    def readings(self, dive: Dive) -> UserReadings:
        """Ask for what is not there."""
        return UserReadings(
            dive.topics["sped"].time_ns, dive.topics["sped"].values, np.array([SD_MPS])
        )


class NoNumbers(Speed):
    """Readings of which two are none."""

    def readings(self, dive: Dive) -> UserReadings:
        """Spoil two."""
        found = super().readings(dive)
        found.values[[7, 9]] = np.nan
        return found


class Unreturned(Speed):
    """Readings that are not returned."""

    def readings(self, dive: Dive) -> UserReadings:
        """Forget them."""
        return None  # type: ignore[return-value]


class Leaving(Speed):
    """Readings that leave the program."""

    def readings(self, dive: Dive) -> UserReadings:
        """Leave as scripts do."""
        sys.exit("no file of ranges")


class Six(Speed):
    """Readings of more components than a filter takes."""

    def readings(self, dive: Dive) -> UserReadings:
        """Repeat them."""
        found = super().readings(dive)
        return UserReadings(
            found.time_ns, np.repeat(found.values, 6, axis=1), np.repeat(found.sd, 6)
        )


class Misspelt(Speed):
    """A name in the prediction that is none."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write what is not there."""
        z[0] = sped  # type: ignore[name-defined]  # noqa: F821


class WrongSign(Deep):
    """The height's error is up, and the position's down."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write -h."""
        z[0], H[0, 14] = -ins[2], -1.0


class NoJacobian(Deep):
    """A prediction without H."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write -h."""
        z[0] = -ins[2]
