"""Frozen settings of a replay, each key with its unit. The defaults are the paper's setting, but for `uncertainty`.

`config_file` reads and writes them as TOML.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta, Struct

from insdvl_replay.core.held_out import HeldOut
from insdvl_replay.core.states import AIDING, BY_SENSOR, MORE_STATES, SENSORS

Vector = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Latency = Annotated[float, Meta(ge=-3600, le=3600)]


def Comment(comment: str) -> Meta:  # noqa: N802
    """Return the comment that `render_toml` writes after a key."""
    return Meta(description=comment)


AXES = 'frd | flu | a signed permutation such as "+x-y-z"; left out: by type, else frd'
STAMP = (
    "header | log_time | publish_time | a field path | of a table also a column with its unit, such as t [ms], or a "
    "rate, such as 100 Hz; left out: by type, else header"
)
FoundTopic = Annotated[str | None, Comment("left out: found by type")]
FieldPath = Annotated[str | None, Comment("field path; left out: by type")]
Stamp = Annotated[str | None, Comment(STAMP)]
StampLatency = Annotated[
    Latency, Comment("s, stamp minus time of validity; subtracted from the stamp")
]
AttitudeMounting = Annotated[
    Vector, Comment("roll, pitch, heading of its axes in the IMU's axes, deg")
]


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the configuration."""


class Vehicle(Section, frozen=True):
    """Which vehicle made the dive."""

    name: Annotated[
        str, Comment("dives with the same name are of one vehicle; left empty: all are")
    ] = ""


class Imu(Section, frozen=True):
    """Where the specific force and angular rate come from."""

    topic: FoundTopic = None
    specific_force: FieldPath = None
    angular_rate: FieldPath = None
    specific_force_unit: Annotated[
        Literal["m/s2", "g", "mg", "ug", "cm/s2", "mm/s2", "ft/s2"] | None,
        Comment(
            "m/s2 | g | mg | ug | cm/s2 | mm/s2 | ft/s2; left out: by type or title, else m/s2"
        ),
    ] = None
    angular_rate_unit: Annotated[
        Literal["rad/s", "deg/s", "mrad/s", "mdeg/s", "deg/min", "deg/h", "rad/h", "rpm"] | None,
        Comment(
            "rad/s | deg/s | mrad/s | mdeg/s | deg/min | deg/h | rad/h | rpm; left out: by type or title, else rad/s"
        ),
    ] = None
    increment_s: Annotated[
        Positive | str | None,
        Comment(
            "readings are increments (delta velocity, delta angle) over this time, and are divided by it: seconds, or "
            "the field path of the interval; left out: by type"
        ),
    ] = None
    specific_force_scale: Annotated[
        Positive, Comment("measured over true specific force; readings are divided by it")
    ] = 1.0
    angular_rate_scale: Annotated[
        Positive, Comment("measured over true rate; readings are divided by it")
    ] = 1.0
    axes: Annotated[str | None, Comment(AXES)] = None
    specific_force_axes: Annotated[
        str | None, Comment("if they differ from axes; left out: by type, else as axes")
    ] = None
    mounting_rpy_deg: Annotated[
        Vector,
        Comment(
            "these axes to the body's, roll, pitch, heading; for an IMU that is built in obliquely"
        ),
    ] = (0.0, 0.0, 0.0)
    stamp: Stamp = None
    latency_s: StampLatency = 0.0
    min_rate_hz: Annotated[NotNegative, Comment("a slower IMU is an error")] = 20.0
    max_gap_s: Annotated[Positive, Comment("gaps up to this are bridged as normal steps")] = 0.5
    long_gaps: Annotated[
        Literal["grow", "split"],
        Comment(
            "longer gaps: grow = add uncertainty, up to a quarter turn | split = replay the longest part without one"
        ),
    ] = "grow"
    gap_accel_mps2: Annotated[
        NotNegative, Comment("sd of the unmeasured acceleration in a long gap, each axis")
    ] = 0.5
    gap_rate_degps: Annotated[
        NotNegative, Comment("sd of the unmeasured turn rate in a long gap, each axis")
    ] = 5.0


class Dvl(Section, frozen=True):
    """Where the DVL's pings come from, how it is mounted and how good it is."""

    topic: FoundTopic = None
    kind: Annotated[
        Literal["beams", "velocity"] | None, Comment("beams | velocity; left out: by type")
    ] = None
    beam_velocity: Annotated[
        str | None, Comment('field path such as "beams[*].velocity"; left out: by type')
    ] = None
    beam_valid: Annotated[
        str | None, Comment("field path, 0 where a beam is lost; left out: by type")
    ] = None
    velocity: FieldPath = None
    valid: Annotated[
        str | None, Comment("field path, 0 where a ping is invalid; left out: by type")
    ] = None
    invalid: Annotated[
        str | None, Comment("field path, not 0 where a ping is invalid; left out: none")
    ] = None
    velocity_unit: Annotated[
        Literal["m/s", "mm/s", "cm/s", "km/h", "kn", "ft/s", "in/s", "m/min"] | None,
        Comment(
            "m/s | mm/s | cm/s | km/h | kn | ft/s | in/s | m/min; left out: by type or title, else m/s"
        ),
    ] = None
    axes: Annotated[str | None, Comment(AXES)] = None
    stamp: Stamp = None
    latency_s: StampLatency = 0.0
    latency_of_dives_s: Annotated[
        tuple[tuple[str, Latency], ...],
        Comment('latency_s of single dives whose clocks were set differently: [["dive_7", 0.03]]'),
    ] = ()
    beam_tilt_deg: Annotated[
        Annotated[float, Meta(gt=0, lt=90)] | None,
        Comment("from the DVL's z axis; left out: by the message, else 30"),
    ] = None
    beam_azimuth_deg: Annotated[
        tuple[float, ...] | None,
        Comment(
            "from forward towards starboard; left out: by the message, else 45, 135, 225, 315"
        ),
    ] = None
    lever_arm_m: Annotated[Vector, Comment("IMU to DVL, forward-starboard-down")] = (0.0, 0.0, 0.0)
    mounting_rpy_deg: Annotated[Vector, Comment("DVL to body, roll, pitch, heading")] = (
        0.0,
        0.0,
        0.0,
    )
    scale: Annotated[
        Positive, Comment("measured over true velocity; readings are divided by it")
    ] = 1.0
    velocity_sd_mps: Annotated[
        Positive, Comment("noise of a velocity from all beams, same on each axis")
    ] = 0.02
    beam_sd_mps: Annotated[
        Positive | None,
        Comment(
            "noise of one beam; along down it is less, by the beams' tilt. If set, velocity_sd_mps is ignored"
        ),
    ] = None
    max_beam_residual_mps: Annotated[
        Positive | None,
        Comment("pings whose beams disagree by more are dropped; left out: keep all"),
    ] = None


class Depth(Section, frozen=True):
    """Where the depth comes from. It is read if a filter uses it, or if it is held out."""

    topic: FoundTopic = None
    depth: Annotated[
        str | None, Comment("field path, m, positive downwards; left out: by type")
    ] = None
    height: Annotated[
        str | None, Comment("field path, m, positive upwards; left out: by type")
    ] = None
    pressure: FieldPath = None
    pressure_unit: Annotated[
        Literal["Pa", "hPa", "kPa", "dbar", "bar", "mbar", "MPa", "psi"] | None,
        Comment("Pa | hPa | kPa | dbar | bar | mbar | MPa | psi; left out: by title, else Pa"),
    ] = None
    density_kgpm3: Annotated[Positive, Comment("of the water, to convert pressure")] = 1025.0
    surface_height_m: Annotated[
        float | None,
        Comment("height of depth 0 above the ellipsoid; left out: fitted at the start"),
    ] = None
    lever_arm_m: Annotated[Vector, Comment("IMU to the sensor, forward-starboard-down")] = (
        0.0,
        0.0,
        0.0,
    )
    sd_m: Annotated[Positive, Comment("noise of one reading")] = 0.1
    stamp: Stamp = None
    latency_s: StampLatency = 0.0


class Heading(Section, frozen=True):
    """Where an independent heading comes from: an AHRS or a compass. Read under the same conditions as the depth."""

    topic: FoundTopic = None
    quaternion: Annotated[str | None, Comment("field path, x, y, z, w; left out: by type")] = None
    heading: Annotated[
        str | None, Comment("field path, from north over east; left out: by type")
    ] = None
    roll: Annotated[
        str | None, Comment("field path, starboard side down, for the start; left out: by type")
    ] = None
    pitch: Annotated[
        str | None, Comment("field path, bow up, for the start; left out: by type")
    ] = None
    angle_unit: Annotated[
        Literal["deg", "rad"] | None,
        Comment("deg | rad: of heading, roll and pitch; left out: by title, else deg"),
    ] = None
    axes: Annotated[
        Literal["ned_frd", "enu_flu"] | None,
        Comment("ned_frd | enu_flu, of a quaternion; left out: enu_flu"),
    ] = None
    mounting_rpy_deg: AttitudeMounting = (0.0, 0.0, 0.0)
    declination_deg: Annotated[
        Annotated[float, Meta(ge=-180, le=180)],
        Comment("of a compass: magnetic north from true north, clockwise"),
    ] = 0.0
    sd_deg: Annotated[Positive, Comment("noise of one reading")] = 2.0
    bias_sd_deg: Annotated[
        Positive, Comment("sd of its slow error, for filters with the state heading_bias")
    ] = 3.0
    bias_time_s: Annotated[
        Annotated[float, Meta(ge=1)], Comment("correlation time of that error")
    ] = 600.0
    level_sd_deg: Annotated[
        Positive, Comment("sd of its roll and pitch, each, if filters start from them")
    ] = 0.5
    stamp: Stamp = None
    latency_s: StampLatency = 0.0


class Position(Section, frozen=True):
    """Where position fixes come from: GNSS at the surface, or an acoustic system. Read under the same conditions as the
    depth.
    """

    topic: FoundTopic = None
    latitude: FieldPath = None
    longitude: FieldPath = None
    height: Annotated[
        str | None, Comment("field path, m above the ellipsoid; left out: by type")
    ] = None
    angle_unit: Annotated[
        Literal["deg", "rad"] | None,
        Comment("deg | rad: of latitude and longitude; left out: by title, else deg"),
    ] = None
    lever_arm_m: Annotated[Vector, Comment("IMU to the antenna, forward-starboard-down")] = (
        0.0,
        0.0,
        0.0,
    )
    sd_m: Annotated[Positive, Comment("noise of one fix, north and east")] = 2.0
    height_sd_m: Annotated[
        Positive | None, Comment("noise of its height; left out: the height is not used")
    ] = None
    stamp: Stamp = None
    latency_s: StampLatency = 0.0


class Navigation(Section, frozen=True):
    """Where a computed solution comes from: position, velocity and attitude, each optional."""

    topic: FoundTopic = None
    fix: Annotated[
        str | None, Comment("topic of the geographic position; left out: found by type")
    ] = None
    frames: Annotated[
        tuple[str, str] | None, Comment("of transforms: parent and child; the child is the body")
    ] = None
    axes: Annotated[
        Literal["ned_frd", "enu_flu"] | None, Comment("ned_frd | enu_flu; left out: by type")
    ] = None
    latitude: FieldPath = None
    longitude: FieldPath = None
    height: Annotated[
        str | None, Comment("field path, m above the ellipsoid; left out: by type")
    ] = None
    depth: Annotated[str | None, Comment("field path, m; replaces height")] = None
    local_position: Annotated[
        str | None,
        Comment(
            "field path, m from the initial place, in these axes; left out: by type; latitude goes before it"
        ),
    ] = None
    velocity_n: Annotated[
        str | None,
        Comment(
            "field path, north-east-down; east-north-up with axes enu_flu or with a quaternion"
        ),
    ] = None
    velocity_b: Annotated[
        str | None, Comment("field path, in the axes of the body; left out: by type")
    ] = None
    quaternion: Annotated[str | None, Comment("field path, x, y, z, w; left out: by type")] = None
    roll: Annotated[str | None, Comment("field path, starboard side down; left out: by type")] = (
        None
    )
    pitch: Annotated[str | None, Comment("field path, bow up; left out: by type")] = None
    heading: Annotated[
        str | None, Comment("field path, from north over east; left out: by type")
    ] = None
    angle_unit: Annotated[
        Literal["deg", "rad"] | None,
        Comment(
            "deg | rad: of latitude, longitude, roll, pitch and heading; left out: by title, else deg"
        ),
    ] = None
    lever_arm_m: Annotated[
        Vector, Comment("IMU to the point of the solution, forward-starboard-down")
    ] = (
        0.0,
        0.0,
        0.0,
    )
    mounting_rpy_deg: AttitudeMounting = (0.0, 0.0, 0.0)
    stamp: Stamp = None
    latency_s: StampLatency = 0.0


class Reference(Navigation, frozen=True):
    """The solution to start from and to compare with. Position, velocity and attitude are each optional."""

    ignore: Annotated[bool, Comment("true: use no reference, also if the log has one")] = False
    independent: Annotated[bool, Comment("false: it was computed from the same IMU or DVL")] = True
    position_sd_m: Annotated[
        NotNegative,
        Comment("sd of its own error; smaller differences between filters count as none"),
    ] = 0.0
    velocity_sd_mps: Annotated[NotNegative, Comment("the same for velocity, each axis")] = 0.0
    attitude_sd_deg: Annotated[NotNegative, Comment("the same for attitude, each axis")] = 0.0


class Solution(Navigation, frozen=True):
    """The onboard solution, evaluated like a filter. Its keys have the same meaning as those of the reference."""

    topic: Annotated[str | None, Comment("topic of the log; set this or file")] = None
    fix: Annotated[
        str | None, Comment("topic of its geographic position; left out: same as topic")
    ] = None
    file: Annotated[
        str | None,
        Comment(
            "TUM file (time x y z qx qy qz qw), relative to the settings file; set this or topic"
        ),
    ] = None
    sha256: Annotated[
        str | None, Comment("of the file; another file is an error. Left out: any file")
    ] = None
    align: Annotated[
        Literal["none", "position", "heading"] | None,
        Comment(
            "none | position: aligned to the baseline's start | heading: also turned to its heading; "
            "left out: position, or none for geographic positions"
        ),
    ] = None


FILE_ENDINGS: Final = (".tum", ".txt")  # Endings of file names; ROS topics have no dot.


# Keys that name fields of a topic.
TOPIC_KEYS: Final = (
    "latitude",
    "longitude",
    "height",
    "depth",
    "local_position",
    "velocity_n",
    "velocity_b",
    "quaternion",
    "roll",
    "pitch",
    "heading",
)
MOST_BYTES: Final = 1 << 28  # Limit for a solution file; two hours at 200 Hz are 160 MB.


def key_of(name: str) -> str:
    """Return ``file`` or ``topic`` for a name, by its ending."""
    if name.lower().endswith(FILE_ENDINGS):
        return "file"
    return "topic"


def spelled_out(solution: str | Solution) -> Solution:
    """Return the settings of a solution that is given by name only."""
    if isinstance(solution, Solution):
        return solution
    if key_of(solution) == "file":
        return Solution(file=solution)
    return Solution(topic=solution)


class Initial(Section, frozen=True):
    """State and uncertainty at the start. The standard deviations are the paper's, reconstructed."""

    source: Annotated[
        Literal["reference", "level", "sensor"],
        Comment(
            "reference | level (by gravity and DVL) | sensor (attitude of [heading]); "
            "the last two use only the position of a reference"
        ),
    ] = "reference"
    heading_deg: Annotated[
        float | Literal["fit", "sensor"] | None,
        Comment(
            'needed if the reference has no attitude: a number, "fit" (by its track of positions) or "sensor"'
        ),
    ] = None
    latitude_deg: Annotated[
        Annotated[float, Meta(ge=-89.9, le=89.9)] | None,
        Comment("needed if the reference has no position"),
    ] = None
    longitude_deg: Annotated[float, Comment("used if the reference has no position")] = 0.0
    height_m: Annotated[float, Comment("used if the reference has no height")] = 0.0
    accel_bias_mg: Annotated[Vector, Comment("forward, starboard, down")] = (0.0, 0.0, 0.0)
    gyro_bias_degph: Annotated[Vector, Comment("forward, starboard, down")] = (0.0, 0.0, 0.0)
    uncertainty: Annotated[
        Literal["source", "settings"],
        Comment(
            "source (velocity, attitude and position are as uncertain as what they come from; the values below count "
            "where that is unknown, and for random starts) | settings (the values below)"
        ),
    ] = "source"
    velocity_sd_mps: Annotated[Positive, Comment("each axis")] = 0.1
    misalignment_sd_deg: Annotated[
        tuple[Positive, Positive, Positive],
        Comment(
            "north, east, down; with source level only down (heading) is used, the rest is estimated"
        ),
    ] = (0.5, 0.5, 0.5)
    position_sd_m: Annotated[
        tuple[Positive, Positive, Positive],
        Comment(
            "north, east, down; for filters that estimate the position, such as those aided by depth"
        ),
    ] = (1.0, 1.0, 1.0)
    dvl_scale_sd_pct: Annotated[Positive, Comment("for filters with the state dvl_scale")] = 0.5
    dvl_yaw_sd_deg: Annotated[
        Positive, Comment("for filters with the state dvl_yaw (mounting about down)")
    ] = 1.0
    accel_bias_sd_mg: Annotated[Positive, Comment("each axis")] = 50.0
    gyro_bias_sd_degph: Annotated[Positive, Comment("each axis")] = 10.0


class InertialNoise(Section, frozen=True):
    """What a filter assumes of the inertial sensors."""

    accel_white_mps_rts: Annotated[NotNegative, Comment("m/s/sqrt(s)")] = 0.20
    gyro_white_rad_rts: Annotated[NotNegative, Comment("rad/sqrt(s)")] = 3.7e-5
    accel_bias_walk_mps2_rts: Annotated[NotNegative, Comment("m/s^2/sqrt(s)")] = 1e-6
    gyro_bias_walk_radps_rts: Annotated[NotNegative, Comment("rad/s/sqrt(s)")] = 1e-10


FREE: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("noise.accel_white_mps_rts", "noise.gyro_white_rad_rts", "noise.accel_bias_walk_mps2_rts",
            "noise.gyro_bias_walk_radps_rts"),
    "dvl": ("dvl.velocity_sd_mps", "dvl.beam_sd_mps"),
    "biases": ("initial.accel_bias_sd_mg", "initial.gyro_bias_sd_degph"),
}  # fmt: skip
"""Keys that `noise.fit` frees, by its words."""


class Noise(InertialNoise, frozen=True):
    """What the filters assume of the inertial sensors, and what of it is fitted to the dives."""

    fit: Annotated[
        tuple[Literal["imu", "dvl", "biases"], ...],
        Comment(
            "what is fitted to the dives, or taken from the IMU's class: imu | dvl | biases; left out: all "
            "that is not given, and nothing with a preset or another key of [noise]"
        ),
    ] = ()


class Acceleration(Section, frozen=True):
    """The acceleration fitted to past DVL velocities, and how the filter uses it."""

    model: Annotated[
        Literal["windowed", "published"],
        Comment("windowed | published (the paper's, without w x v)"),
    ] = "windowed"
    window: Annotated[
        Annotated[int, Meta(ge=2, le=1000)], Comment("number of velocities, 2 to 1000")
    ] = 3
    order: Annotated[
        Annotated[int, Meta(ge=1)], Comment("order of the fitted polynomial, below window")
    ] = 1
    sd_mps2: Annotated[
        Positive | None, Comment("left out: from the DVL's and the accelerometer's noise")
    ] = None
    max_window_gap_s: Annotated[
        Positive, Comment("a longer gap between pings starts a new window")
    ] = 2.5


class Filter(Section, frozen=True):
    """One filter that is run, or a solution that is read. The first one is the baseline."""

    aiding: Annotated[
        tuple[str, ...],
        Comment(f"measurements, in this order: {' | '.join(AIDING)} | module:Class"),
    ] = ()
    states: Annotated[
        tuple[str, ...],
        Comment(
            f"extra states, besides the twelve and those that its aiding needs: {' | '.join(MORE_STATES)}"
        ),
    ] = ()
    gate_probability: Annotated[
        Annotated[float, Meta(gt=0, le=1)],
        Comment("an innovation outside this share of chi-square is rejected; 1: no gate"),
    ] = 1.0
    gate_reopen_after: Annotated[
        Annotated[int, Meta(ge=0, le=10_000)],
        Comment(
            "after this number of rejections in a row, the velocity is set to the DVL's; 0: never"
        ),
    ] = 5
    accel_white_mps_rts: Annotated[NotNegative | None, Comment("left out: from [noise]")] = None
    gyro_white_rad_rts: Annotated[NotNegative | None, Comment("left out: from [noise]")] = None
    accel_bias_walk_mps2_rts: Annotated[NotNegative | None, Comment("left out: from [noise]")] = (
        None
    )
    gyro_bias_walk_radps_rts: Annotated[NotNegative | None, Comment("left out: from [noise]")] = (
        None
    )
    velocity_sd_mps: Annotated[
        Positive | None, Comment("overrides [dvl]; left out: from [dvl]")
    ] = None
    beam_sd_mps: Annotated[
        Positive | None, Comment("overrides velocity_sd_mps and [dvl]; left out: from [dvl]")
    ] = None
    dvl_noise: Annotated[
        Literal["fixed", "adaptive", "student-t"],
        Comment(
            "R of velocity and beams: fixed | adaptive (from the innovations) | student-t (for outliers)"
        ),
    ] = "fixed"
    noise_factors: Annotated[
        str | None,
        Comment("your noise of the inertial sensors over time: a Python class, module:Class"),
    ] = None
    acceleration: Acceleration | None = None
    solution: Annotated[
        str | Solution | None,
        Comment(
            "the onboard solution; all other keys must be left out: a topic, or a TUM file (.tum, .txt)"
        ),
    ] = None
    program: Annotated[
        tuple[str, ...] | None,
        Comment(
            "your filter: a program and its arguments, with {dive} or {imu_csv} and {dvl_csv}, {start} and {solution}"
        ),
    ] = None
    timeout_s: Annotated[
        Positive | None, Comment("longest time of one run of your filter; left out: 600")
    ] = None
    input: Annotated[
        Literal["clean", "log"] | None,
        Comment(
            "clean | log: what {dive} of the program holds, clean readings or the vehicle's log; left out: clean"
        ),
    ] = None
    candidate: Annotated[str | None, Comment("your filter: a Python class, module:Class")] = None
    version: Annotated[
        str | None,
        Comment(
            "of your code: results are kept until it changes; left out: they are computed each time"
        ),
    ] = None

    @property
    def is_user_code(self) -> bool:
        """Whether it is a program or a class of the user's."""
        return self.program is not None or self.candidate is not None

    @property
    def code(self) -> tuple[str, ...]:
        """The user's code that it names: ``module:Class``, and the files of a program."""
        words = [
            word
            for word in (*self.aiding, self.noise_factors or "", self.candidate or "")
            if ":" in word
        ]
        return (
            *words,
            *(word for i, word in enumerate(self.program or ()) if i == 0 or "/" in word),
        )


def _default_filters() -> dict[str, Filter]:
    return {
        "baseline": Filter(aiding=("velocity",)),
        "aided": Filter(
            aiding=("velocity", "acceleration"), acceleration=Acceleration(sd_mps2=0.103)
        ),
    }


class Clocks(Section, frozen=True):
    """How much the clocks of the roles may differ."""

    max_disagreement_s: Annotated[
        NotNegative,
        Comment(
            "largest allowed difference of log time minus stamp between two roles, beyond their spread"
        ),
    ] = 1.0


class Span(Section, frozen=True):
    """The part of the dive to replay."""

    start_s: Annotated[
        float | None, Comment("seconds from the first IMU sample; left out: from the start")
    ] = None
    end_s: Annotated[
        float | None, Comment("seconds from the first IMU sample; left out: to the end")
    ] = None


class Evaluation(Section, frozen=True):
    """How the filters are compared."""

    starts: Annotated[
        Annotated[int, Meta(ge=1, le=1000)],
        Comment("number of starts per filter, drawn from [initial]; 1: only the dive's own start"),
    ] = 16
    seed: Annotated[
        Annotated[int, Meta(ge=0, le=4_294_967_295)], Comment("random seed of the starts")
    ] = 0
    held_out: Annotated[
        tuple[str, ...],
        Comment(
            f"sensors that no filter uses, and that evaluate all filters: {' | '.join(SENSORS)}"
        ),
    ] = ()
    primary: Annotated[
        str,
        Comment(
            "quantity that decides, such as drift_60s; left out: position, else outage_60s, else outage_30s"
        ),
    ] = ""
    lost_m: Annotated[
        Positive, Comment("horizontal position error above which a vehicle counts as lost")
    ] = 10.0
    candidate: Annotated[
        str, Comment("filter that the question is about; the others share the error rate")
    ] = ""
    repeats: Annotated[
        bool,
        Comment(
            "whether your own filters run again, unchanged and with changes of the input that mean nothing"
        ),
    ] = True


class Topic(Section, frozen=True):
    """A topic for user-defined measurements, by the name of its section: ``dive.topics["range"]``."""

    topic: Annotated[str, Comment("topic of the log")]
    values: Annotated[
        str, Comment("field path; for several numbers all paths, separated by commas")
    ]
    sensor: Annotated[
        Literal["dvl", "depth", "heading", "position"] | None,
        Comment(
            "dvl | depth | heading | position: sensor of the data; not available if that sensor is held out"
        ),
    ] = None
    stamp: Stamp = None
    latency_s: StampLatency = 0.0


class Found(Section, frozen=True):
    """How the settings of a file were found. It sets nothing."""

    given: Annotated[
        tuple[str, ...], Comment("keys that were given, beside which the others were found")
    ] = ()


class Config(Section, frozen=True):
    """All settings of a replay."""

    vehicle: Vehicle = Vehicle()
    imu: Imu = Imu()
    dvl: Dvl = Dvl()
    depth: Depth = Depth()
    heading: Heading = Heading()
    position: Position = Position()
    reference: Reference = Reference()
    initial: Initial = Initial()
    noise: Noise = Noise(fit=("imu", "dvl", "biases"))  # while nobody gives any
    clocks: Clocks = Clocks()
    span: Span = Span()
    evaluation: Evaluation = Evaluation()
    topics: dict[str, Topic] = msgspec.field(default_factory=dict)
    filters: dict[str, Filter] = msgspec.field(default_factory=_default_filters)

    @property
    def baseline(self) -> str:
        """Name of the first filter."""
        return next(iter(self.filters))

    @property
    def computed(self) -> dict[str, Filter]:
        """The tool's own filters."""
        given = self.filters.items()
        return {
            name: filter_
            for name, filter_ in given
            if filter_.solution is None and not filter_.is_user_code
        }

    @property
    def user_candidates(self) -> dict[str, Filter]:
        """The programs and classes of the user's, by filter."""
        return {name: filter_ for name, filter_ in self.filters.items() if filter_.is_user_code}

    @property
    def code(self) -> tuple[str, ...]:
        """The user's code that filters name."""
        words: dict[str, None] = {}  # each once
        for filter_ in self.filters.values():
            words |= dict.fromkeys(filter_.code)
        return tuple(words)

    @property
    def held_out(self) -> HeldOut:
        """What no filter is told, so that it judges them."""
        return HeldOut(self.evaluation.held_out)

    @property
    def sensors(self) -> tuple[str, ...]:
        """The sensors that a replay reads: those that aid filters, that they start from, or that are held out."""
        asked = {*self.held_out.sensors}
        for filter_ in self.filters.values():
            asked.update(filter_.aiding)
        if BY_SENSOR in (self.initial.source, self.initial.heading_deg):
            asked.add("heading")
        return tuple(name for name in SENSORS if name in asked)

    def without_code(self) -> "Config":
        """Return the settings without the user's code; a filter without other aiding is left out."""
        kept = {}
        for name, filter_ in self.filters.items():
            aiding = tuple(word for word in filter_.aiding if ":" not in word)
            if aiding or filter_.solution is not None:
                kept[name] = msgspec.structs.replace(
                    filter_, aiding=aiding, noise_factors=None, version=None
                )
        return msgspec.structs.replace(self, filters=kept or _default_filters())

    def of_dive(self, name: str) -> "Config":
        """Return the settings of one dive, with the DVL latency of this dive."""
        latency_s = dict(self.dvl.latency_of_dives_s).get(name, self.dvl.latency_s)
        return msgspec.structs.replace(
            self, dvl=msgspec.structs.replace(self.dvl, latency_s=latency_s)
        )

    def of_vehicle(self, name: str) -> "Config":
        """Return the settings of a dive of this vehicle; an empty name leaves theirs."""
        if name:
            return msgspec.structs.replace(self, vehicle=Vehicle(name=name))
        return self

    def without_solutions(self) -> "Config":
        """Return the settings without filters that read a solution."""
        return msgspec.structs.replace(self, filters=self.computed)

    @property
    def solutions(self) -> dict[str, Solution]:
        """The solutions that are read, by filter."""
        given = {name: filter_.solution for name, filter_ in self.filters.items()}
        return {
            name: spelled_out(solution) for name, solution in given.items() if solution is not None
        }


class ConfigFile(Config, frozen=True):
    """All that a file of settings may hold."""

    found: Found = Found()


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield nested settings by their dotted keys; lists stay whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", list(value) if isinstance(value, tuple) else value
