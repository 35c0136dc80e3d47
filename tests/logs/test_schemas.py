"""The interface package that robots build is the text that the writer embeds."""

import re
from pathlib import Path
from xml.etree import ElementTree

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from insdvl_replay import __version__
from insdvl_replay.core.states import STATES
from insdvl_replay.logs.formats.definitions import definition_text, parse_definitions

PACKAGE = Path(__file__).resolve().parents[2] / "schemas" / "insdvl_msgs"
TYPES = sorted(file.stem for file in (PACKAGE / "msg").glob("*.msg"))
TABLES = {
    "ImprovementRow": "log,filter,state,unit,baseline_sd,sd,improvement_pct,status",
    "ConvergenceRow": "log,filter,state,unit,target_sd,baseline_s,reached_s,improvement_pct,status,"
    "measured_target,measured_baseline_s,measured_s,measured_status,unchanged_s,"
    "nearest_approach_s,nearest_approach_improvement_pct",
    "ReferenceErrorRow": "log,filter,quantity,unit,baseline_rmse,rmse,improvement_pct,baseline_final,final,samples,"
    "status",
    "ConsistencyRow": "log,filter,measurement,dof,used,rejected,mean_nis,low,high,verdict,autocorrelation,"
    "autocorrelation_limit,whiteness,why",
    "CredibilityRow": "log,filter,quantity,dof,samples,mean_nees,low,high,within_1sd_pct,within_3sd_pct,verdict,"
    "effective_samples,why",
    "EvidenceRow": "log,filter,evidence,quantity,unit,baseline,value,ratio,moves,acts,reference_noise,samples,starts,"
    "from_s,role",
    "OutageRow": "log,filter,window_s,windows,left_out,drift_median_m,drift_rms_m,drift_p95_m,drift_of_distance_pct,"
    "end_velocity_mps,vertical_median_m,ratio_to_baseline,windows_won_pct,nis_per_dof",
}
UNITS = {"m/s": "mps", "mrad": "mrad", "mg": "mg", "deg/h": "degph"}


def field_names(type_name: str) -> list[str]:
    full = f"insdvl_msgs/msg/{type_name}"
    return [field.name for field in parse_definitions(full, definition_text(full))[full]]


def test_package_builds_every_message() -> None:
    listed = re.findall(r'"msg/(\w+)\.msg"', (PACKAGE / "CMakeLists.txt").read_text("utf-8"))
    assert listed == TYPES


def test_package_declares_what_its_messages_use() -> None:
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    used = {name.partition("/")[0] for t in TYPES for name in direct_types(t)} - {"insdvl_msgs"}
    assert {element.text for element in package.findall("depend")} == used
    declared = re.search(r"DEPENDENCIES (.+)", (PACKAGE / "CMakeLists.txt").read_text("utf-8"))
    assert declared is not None
    assert set(declared[1].split()) == used
    assert [group.text for group in package.findall("member_of_group")] == [
        "rosidl_interface_packages"
    ]


def direct_types(type_name: str) -> list[str]:
    full = f"insdvl_msgs/msg/{type_name}"
    fields = parse_definitions(full, definition_text(full))[full]
    return [field.type_name for field in fields if "/" in field.type_name]


def test_package_has_the_version_of_the_tool() -> None:
    assert ElementTree.parse(PACKAGE / "package.xml").getroot().findtext("version") == __version__


def test_embedded_texts_start_with_the_files_and_are_understood_by_rosbags() -> None:
    for type_name in TYPES:
        full = f"insdvl_msgs/msg/{type_name}"
        text, embedded = (
            (PACKAGE / "msg" / f"{type_name}.msg").read_text("utf-8"),
            definition_text(full),
        )
        assert embedded.startswith(text + "=" * 80 + "\nMSG: std_msgs/Header\n"), type_name
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(embedded, full))
        assert [name for name, _ in store.get_msgdef(full).fields] == field_names(type_name)


def test_every_message_has_a_header_names_that_ros_accepts_and_explained_fields() -> None:
    for type_name in TYPES:
        names = field_names(type_name)
        assert names[0] == "header"
        assert all(re.fullmatch(r"[a-z](_?[a-z0-9]+)*", name) for name in names), type_name
        paragraphs = (
            (PACKAGE / "msg" / f"{type_name}.msg").read_text("utf-8").strip().split("\n\n")
        )
        assert all(paragraph.startswith("# ") for paragraph in paragraphs), type_name


def test_rows_have_the_columns_of_the_csv_files() -> None:
    assert {name: ",".join(field_names(name)[1:]) for name in TABLES} == TABLES


def test_sigma_has_the_states_with_their_shown_units() -> None:
    assert field_names("FilterSigma")[1:] == [
        f"{state.id}_{UNITS[state.unit]}" for state in STATES
    ]
