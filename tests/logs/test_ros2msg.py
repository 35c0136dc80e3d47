"""The interface language: what a definition says, what is missing in it, and what the known types are."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding import ros2msg
from insdvl_replay.logs.encoding.ros2msg import Definition, Field, definition_text, full_name, parse_definitions

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
DEFINITIONS = sorted((ROOT / "insdvl_replay" / "logs" / "definitions").glob("*/msg/*.msg"))
PROJECT = sorted((ROOT / "schemas" / "insdvl_msgs" / "msg").glob("*.msg"))
KNOWN = [f"{file.parts[-3]}/msg/{file.stem}" for file in DEFINITIONS + PROJECT]

TEXT = """\
# A comment with float64 field
uint8 A=1
string NAME = "x # y"   # a constant
float64 with_default 0.5
string<=10 bounded "a=b"  # a comment
int32[3] three\t
bool[] any
float32[<=5] at_most_five [1.0, 2.0]
string<=4[<=2] words
Header header
Local[2] local
other_pkg/Thing thing
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===
MSG: builtin_interfaces/msg/Time

int32 sec
uint32 nanosec
================================================================================
MSG: pkg/Local
byte b
char c
================================================================================
MSG: other_pkg/Thing
int8 NOTHING=0
"""


def test_parse_takes_fields_and_leaves_constants_defaults_bounds_and_comments() -> None:
    definitions = parse_definitions("pkg/msg/Top", TEXT)
    assert definitions["pkg/msg/Top"].fields == (
        Field("with_default", "float64", "single", 1),
        Field("bounded", "string", "single", 1),
        Field("three", "int32", "array", 3),
        Field("any", "bool", "sequence", 0),
        Field("at_most_five", "float32", "sequence", 0),
        Field("words", "string", "sequence", 0),
        Field("header", "std_msgs/msg/Header", "single", 1),
        Field("local", "pkg/msg/Local", "array", 2),
        Field("thing", "other_pkg/msg/Thing", "single", 1),
    )


def test_parse_names_every_type_in_full() -> None:
    assert list(parse_definitions("pkg/Top", TEXT)) == [
        "pkg/msg/Top",
        "std_msgs/msg/Header",
        "builtin_interfaces/msg/Time",
        "pkg/msg/Local",
        "other_pkg/msg/Thing",
    ]


def test_parse_gives_an_empty_message_its_byte() -> None:
    dummy = Field("structure_needs_at_least_one_member", "uint8", "single", 1)
    assert parse_definitions("pkg/msg/Top", TEXT)["other_pkg/msg/Thing"] == Definition("other_pkg/msg/Thing", (dummy,))


def test_parse_reads_text_with_windows_line_ends() -> None:
    assert parse_definitions("pkg/msg/Top", TEXT.replace("\n", "\r\n")) == parse_definitions("pkg/msg/Top", TEXT)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("other/Missing field", "other/msg/Missing"),
        ("Local field", "pkg/msg/Local"),
        ("float64", "'float64'"),
        ("int32 x;", "'int32 x;'"),
        ("float64 x\n====\nfloat64 y", "'float64 y'"),
        ("Top again", "itself"),
        ("Local x\n===\nMSG: pkg/Local\nTop[] tops", "itself"),
    ],
)
def test_parse_says_what_is_wrong_with_a_schema(text: str, said: str) -> None:
    with pytest.raises(LogError) as caught:
        parse_definitions("pkg/msg/Top", text)
    assert "pkg/msg/Top" in caught.value.message
    assert said in caught.value.message
    assert caught.value.hint


def test_full_name() -> None:
    assert full_name("pkg/Type") == full_name("pkg/msg/Type") == "pkg/msg/Type"


@pytest.mark.parametrize("type_name", KNOWN)
def test_text_of_a_known_type_is_complete(type_name: str) -> None:
    definitions = parse_definitions(type_name, definition_text(type_name))
    assert next(iter(definitions)) == type_name


@pytest.mark.parametrize("type_name", [name for name in KNOWN if name in get_typestore(Stores.ROS2_HUMBLE).types])
def test_known_types_agree_with_rosbags(type_name: str) -> None:
    fields = parse_definitions(type_name, definition_text(type_name))[type_name].fields
    theirs = get_typestore(Stores.ROS2_HUMBLE).get_msgdef(type_name).fields
    assert [(field.name, field.type_name, field.length) for field in fields] == [
        _flat(name, description) for name, description in theirs
    ]


def _flat(name: str, description: tuple[int, object]) -> tuple[str, object, int]:
    """Bring a field description of rosbags into the form name, type, number of values."""
    node, argument = description
    if int(node) in (3, 4):  # an array or a sequence, whose length is 0 in both
        (inner, length) = argument
        return name, _type_of(inner), length
    return name, _type_of(description), 1


def _type_of(description: tuple[int, object]) -> object:
    node, argument = description
    return argument[0] if int(node) == 1 else argument


def test_known_types_agree_with_recorded_logs() -> None:
    if not DATA.exists():
        pytest.skip("needs ../shared/data (recorded logs)")
    compared = set()
    for log in ("cougars/so_lastbag.mcap", "snapir/snapir_01.mcap", "stanford_auv/rotation_z_1.mcap"):
        with (DATA / log).open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None
        for schema in summary.schemas.values():
            # This vehicle's driver is older than the fields with the times of validity and transmission.
            if schema.name in KNOWN and schema.name != "dvl_msgs/msg/DVL":
                recorded = parse_definitions(schema.name, schema.data.decode())
                assert recorded == parse_definitions(schema.name, definition_text(schema.name))
                compared.add(schema.name)
    assert {"sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "rcl_interfaces/msg/Log"} <= compared


def test_text_of_an_unknown_type_is_refused() -> None:
    with pytest.raises(LogError, match="pkg/msg/Nothing"):
        definition_text("pkg/msg/Nothing")


def test_project_definitions_are_found_beside_the_package_and_inside_it() -> None:
    _, inside, beside = ros2msg._definition_folders()
    assert inside == ROOT / "insdvl_replay" / "schemas"
    assert beside == ROOT / "schemas"


@pytest.mark.parametrize("name", ["x/msg/" + "N" * 5000, "../../etc/msg/Passwd", "x/msg/../Imu"])
def test_a_name_that_no_file_of_ours_can_have_is_no_known_type(name: str) -> None:
    with pytest.raises(LogError, match="no definition of this type comes with the tool"):
        definition_text(name)
