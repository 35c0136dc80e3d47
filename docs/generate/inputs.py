"""The tables of docs/inputs.md, by those of the types that are known. `make inputs` renews them; a test compares."""

from collections.abc import Iterable

from written import PROJECT, markdown_table, renewed

from insdvl_replay.core.states import SENSORS
from insdvl_replay.logs.columns.topics import LOG_TIME, ROLES, TYPES, KnownType, Types
from insdvl_replay.logs.formats.fields import ENCODINGS
from insdvl_replay.logs.formats.known_formats import FORMATS, OTHER_FORMATS, Format

PAGE = PROJECT / "docs" / "inputs.md"


TIMES_IN_FILES = {
    "ardupilot": "time of the record, or of its frame",
    "cerulean": "time in the sentence, of `$DVEXT` the sum of its steps",
    "nortek": "time in the sentence",
    "nucleus": "`timeStamp` and `microSeconds`",
    "px4": "`timestamp_sample`, else `timestamp`",
    "teledyne": "the instrument's clock",
    "waterlinked": "time of validity, else sum of `time`",
}
"""What readers of files of instruments take for the time of a row, by the first word of its type."""


def _stamp(entry: KnownType) -> str:
    if entry.stamp == LOG_TIME:
        maker = entry.names[0].partition(".")[0]
        return TIMES_IN_FILES.get(maker, "the recorder's time")
    return f"`{entry.stamp}`" if entry.stamp else "header"


def _rows(known: Types) -> Iterable[tuple[str, str, str, str]]:
    for entry in {id(entry): entry for entry in known.values()}.values():
        yield (
            "<br>".join(f"`{name}`" for name in entry.names),
            _gives(entry),
            _stamp(entry),
            entry.about,
        )


def _gives(entry: KnownType) -> str:
    fields = entry.fields.keys()
    if (
        fields & {"beam_velocity", "beam_velocity_vectors"}
        and entry.conventions.get("kind") != "velocity"
    ):
        return "beams"
    if "velocity" in fields:
        return "velocity"
    by_field = {
        "position": {"latitude", "local_position"},
        "velocity": {"velocity_n", "velocity_b"},
        "attitude": {"quaternion", "roll"},
        "increments": {"force_interval_us"},
        "samples": {"specific_force"},
        "true biases": {"accel_bias"},
    }
    found = [word for word, quantities in by_field.items() if fields & quantities]
    return ", ".join(word for word in found if word != "samples" or "increments" not in found)


def _types(*groups: str) -> str:
    return markdown_table(
        ("type", "gives", "stamp", "remarks"),
        [row for group in groups for row in _rows(TYPES[group])],
    )


def _sensors() -> str:
    """The types of each sensor beside IMU and DVL, those last that have to be named."""
    rows = [
        (types, f"{name}, attitude" if gives == "attitude" else name, stamp, about)
        for name in SENSORS
        for group in (*ROLES[name].groups, *ROLES[name].if_named)
        for types, gives, stamp, about in _rows(TYPES[group])
    ]
    return markdown_table(("type", "gives", "stamp", "remarks"), rows)


def _other(endings: tuple[str, ...]) -> str:
    return ", ".join(f"`{ending}`" for ending in endings)


def _command(known: Format) -> str:
    """The one command from a file to the verdict; an IMU that the file lacks is a table beside it."""
    if "IMU" in known.lacks:
        return f"`insdvl-replay run --one-dive {known.example} imu.csv`"
    return f"`insdvl-replay run {known.example}`"


PARTS = {
    "encodings": lambda: markdown_table(
        ("messages", "schemas"),
        [
            (f"`{name}`", ", ".join(f"`{kind}`" if kind else "none" for kind in kinds))
            for name, kinds in ENCODINGS.items()
        ],
    ),
    "imu": lambda: _types("imu", "imu_of_drivers", "imu_if_named"),
    "dvl": lambda: _types("dvl_beams", "dvl_velocity", "dvl_if_named"),
    "reference": lambda: _types(
        "nav_solution", "odometry", "fix", "extended_fix", "poses", "flown", "truth"
    ),
    "sensors": _sensors,
    "instruments": lambda: markdown_table(
        ("instrument", "endings", "command", "what it has", "what it lacks"),
        [
            (
                known.name,
                _other(known.endings),
                _command(known),
                known.holds,
                known.lacks or "nothing",
            )
            for known in FORMATS
            if known.name
        ],
    ),
    "others": lambda: markdown_table(
        ("file", "endings", "what to do"),
        [
            (known.name, _other(known.endings), known.step)
            for known in OTHER_FORMATS
            if known.endings
        ],
    ),
}


def written() -> str:
    """The page as it should be."""
    return renewed(PAGE.read_text("utf-8"), PARTS, "make inputs")


if __name__ == "__main__":
    PAGE.write_text(written(), "utf-8")
