"""The interface language: what a definition says, what is missing in it, and what the known types are."""

import re
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.definitions import (
    Field,
    definition_folders,
    definition_text,
    parse_definitions,
)

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


def test_parse_takes_fields_by_full_types_and_leaves_constants_defaults_bounds_and_comments() -> (
    None
):
    definitions = parse_definitions("pkg/msg/Top", TEXT)
    assert definitions["pkg/msg/Top"] == (
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
    dummy = Field("structure_needs_at_least_one_member", "uint8", "single", 1)
    assert definitions["other_pkg/msg/Thing"] == (dummy,)
    assert list(definitions) == [
        "pkg/msg/Top",
        "std_msgs/msg/Header",
        "builtin_interfaces/msg/Time",
        "pkg/msg/Local",
        "other_pkg/msg/Thing",
    ]
    assert parse_definitions("pkg/Top", TEXT.replace("\n", "\r\n")) == definitions


WRONG = [
    ("other/Missing field", "other/msg/Missing"),
    ("int32 x;", "'int32 x;'"),
    ("float64 x\n====\nfloat64 y", "'float64 y'"),
    ("Local x\n===\nMSG: pkg/Local\nTop[] tops", "itself"),
]


def test_parse_says_what_is_wrong_with_a_schema() -> None:
    for text, said in WRONG:
        with pytest.raises(LogError, match=rf"pkg/msg/Top.*{re.escape(said)}") as caught:
            parse_definitions("pkg/msg/Top", text)
        assert caught.value.hint


def test_known_types_are_complete_and_agree_with_rosbags() -> None:
    store, compared = get_typestore(Stores.ROS2_HUMBLE), 0
    for type_name in KNOWN:
        definitions = parse_definitions(type_name, definition_text(type_name))
        assert next(iter(definitions)) == type_name
        if type_name in store.types:
            theirs = [
                _flat(name, description)
                for name, description in store.get_msgdef(type_name).fields
            ]
            ours = [
                (field.name, field.type_name, field.length) for field in definitions[type_name]
            ]
            assert ours == theirs, type_name
            compared += 1
    assert compared > 20


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
    for log in (
        "cougars/so_lastbag.mcap",
        "snapir/snapir_01.mcap",
        "stanford_auv/rotation_z_1.mcap",
    ):
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


def test_project_definitions_are_found_next_to_the_package_and_inside_it() -> None:
    _, inside, beside = definition_folders()
    assert inside == ROOT / "insdvl_replay" / "schemas"
    assert beside == ROOT / "schemas"


def test_text_of_an_unknown_type_is_refused_also_of_names_that_no_file_can_have() -> None:
    for name in ("pkg/msg/Nothing", "x/msg/" + "N" * 5000, "../../etc/msg/Passwd", "x/msg/../Imu"):
        with pytest.raises(LogError, match="no definition of this type comes with the tool"):
            definition_text(name)
