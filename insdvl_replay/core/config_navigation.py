"""Settings of what others have found: the reference, and solutions of the vehicle that are judged as filters are."""

from typing import Annotated, Final, Literal

from insdvl_replay.core.config_section import STAMP, Comment, Latency, NotNegative, Section, Vector


class Navigation(Section, frozen=True):
    """Where positions, velocities and attitudes come from that somebody else has found; each is optional."""

    topic: Annotated[str | None, Comment("left out: found by type")] = None
    fix: Annotated[str | None, Comment("topic of the geographic position; left out: found by type")] = None
    frames: Annotated[tuple[str, str] | None, Comment("of transforms: parent and child, the child being the body")] = (
        None
    )
    axes: Annotated[Literal["ned_frd", "enu_flu"] | None, Comment("ned_frd | enu_flu; left out: by type")] = None
    latitude: Annotated[str | None, Comment("field path; left out: by type")] = None
    longitude: Annotated[str | None, Comment("field path; left out: by type")] = None
    height: Annotated[str | None, Comment("field path, m above the ellipsoid; left out: by type")] = None
    depth: Annotated[str | None, Comment("field path, m, in place of the height")] = None
    velocity_n: Annotated[
        str | None, Comment("field path, north-east-down, or east-north-up with such axes or beside a quaternion")
    ] = None
    velocity_b: Annotated[str | None, Comment("field path, in the axes of the body; left out: by type")] = None
    quaternion: Annotated[str | None, Comment("field path, x, y, z, w; left out: by type")] = None
    roll: Annotated[str | None, Comment("field path, starboard side down; left out: by type")] = None
    pitch: Annotated[str | None, Comment("field path, bow up; left out: by type")] = None
    heading: Annotated[str | None, Comment("field path, from north over east; left out: by type")] = None
    angle_unit: Annotated[
        Literal["deg", "rad"], Comment("deg | rad: of latitude, longitude, roll, pitch and heading")
    ] = "deg"
    lever_arm_m: Annotated[Vector, Comment("IMU to the point that it is of, forward-starboard-down")] = (0.0, 0.0, 0.0)
    mounting_rpy_deg: Annotated[
        Vector, Comment("axes of its attitude in those of the IMU: heading, then pitch, then roll")
    ] = (0.0, 0.0, 0.0)
    stamp: Annotated[str | None, Comment(STAMP)] = None
    latency_s: Annotated[Latency, Comment("seconds from validity to stamp, taken off the stamp")] = 0.0


class Reference(Navigation, frozen=True):
    """The solution to start from and to compare with; position, velocity and attitude are each optional."""

    independent: Annotated[bool, Comment("false: it was made from the same IMU or DVL")] = True
    position_sd_m: Annotated[
        NotNegative, Comment("its own error: smaller differences between filters count as none")
    ] = 0.0
    velocity_sd_mps: Annotated[NotNegative, Comment("likewise, each axis")] = 0.0
    attitude_sd_deg: Annotated[NotNegative, Comment("likewise, each axis")] = 0.0


class Solution(Navigation, frozen=True):
    """A solution that the vehicle found itself, to be judged as a filter is; its keys are read as the reference's."""

    topic: Annotated[str | None, Comment("of the log; or file")] = None
    fix: Annotated[str | None, Comment("topic of its geographic position; left out: that of its own topic")] = None
    file: Annotated[str | None, Comment("a TUM file: time x y z qx qy qz qw, beside the settings; or topic")] = None
    sha256: Annotated[str | None, Comment("of the file, which another one is not taken for; left out: that it has")] = (
        None
    )
    align: Annotated[
        Literal["none", "position", "heading"] | None,
        Comment(
            "none | position: laid on the baseline where it begins | heading: turned to it, too; left out: position, "
            "of geographic ones none"
        ),
    ] = None


FILE_ENDINGS: Final = (".tum", ".txt")
"""How a name ends that is of a file; no topic of ROS has a dot."""


TOPIC_KEYS: Final = (
    "latitude",
    "longitude",
    "height",
    "depth",
    "velocity_n",
    "velocity_b",
    "quaternion",
    "roll",
    "pitch",
    "heading",
)
"""Keys that name fields of a topic."""
MOST_BYTES: Final = 1 << 28
"""Of a file with a solution: two hours at 200 Hz have 160 MB."""


def key_of(name: str) -> str:
    """Return the key that a mere name stands for: it is a file, by its ending, or a topic."""
    return "file" if name.lower().endswith(FILE_ENDINGS) else "topic"


def spelled_out(solution: str | Solution) -> Solution:
    """Return the settings that a mere name stands for."""
    if isinstance(solution, Solution):
        return solution
    return Solution(file=solution) if key_of(solution) == "file" else Solution(topic=solution)
