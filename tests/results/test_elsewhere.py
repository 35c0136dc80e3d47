"""Other people's tools: what Foxglove and Lichtblick read a replay.mcap with, and the layouts that are shipped."""

import json
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from insdvl_replay.core.config_file import load_config
from insdvl_replay.preparation.replay import replay_log
from insdvl_replay.show.result_files import save_replay, viewer_layouts

PROJECT = Path(__file__).resolve().parents[2]
LAYOUTS = PROJECT / "insdvl_replay" / "show" / "layouts"
NODE = PROJECT / "tests" / "node"
VEHICLES = {
    "straight": None,
    "figure_eight": None,
    "snapir_01": PROJECT / "examples" / "snapir.toml",
}


ALL_BUT_ONE = [pytest.param(name, marks=pytest.mark.nightly) for name in ("straight", "snapir_01")]


@pytest.fixture(scope="module", params=["figure_eight", *ALL_BUT_ONE])
def result(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Result folder of both samples, and of a real dive where someone has it."""
    name, folder = request.param, tmp_path_factory.mktemp("result")
    logs = PROJECT / "sample_logs"
    if name.startswith("snapir"):
        logs = request.getfixturevalue("snapir")
    save_replay(replay_log(logs / f"{name}.mcap", load_config(file=VEHICLES[name])), folder)
    return folder


@pytest.mark.nightly
@pytest.mark.skipif(
    shutil.which("node") is None or not (NODE / "node_modules").is_dir(),
    reason="needs node and the libraries in tests/node (make extras)",
)
def test_foxgloves_libraries_read_every_message_with_the_values_of_the_tables(
    result: Path,
) -> None:
    command = ["node", NODE / "read_replay.mjs", result / "replay.mcap"]
    printed = json.loads(
        subprocess.run(command, check=True, capture_output=True, text=True).stdout
    )
    topics = printed["topics"]
    with (result / "replay.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = {
        summary.channels[id_].topic: count
        for id_, count in summary.statistics.channel_message_counts.items()
    }
    assert {topic: found["count"] for topic, found in topics.items()} == counts
    assert sum(counts.values()) == printed["stated"]
    for name in ("improvement", "convergence", "reference_error", "consistency", "credibility"):
        last = pd.read_csv(result / f"{name}.csv").iloc[-1].to_dict()
        shown = topics[f"/insdvl/table/{name}"]["last"]
        # An empty text is an empty cell, which pandas takes for a missing number.
        assert {key: None if shown[key] == "" else shown[key] for key in last} == {
            key: None if value != value else value for key, value in last.items()
        }
    report = json.loads((result / "report.json").read_bytes())
    assert (
        topics["/insdvl/baseline/state"]["last"]["header"]["stamp"]["sec"]
        == report["log"]["end_ns"] // 10**9
    )


@pytest.mark.nightly
def test_both_readers_of_ros_read_every_message_with_the_values_of_the_tables(
    result: Path,
) -> None:
    log = result / "replay.mcap"
    counts: Counter[str] = Counter()
    with AnyReader([log]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
    last, theirs = {}, Counter()
    with log.open("rb") as file:
        for _, channel, _, message in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            last[channel.topic] = message
            theirs[channel.topic] += 1
    assert counts == theirs
    for name in ("improvement", "convergence", "reference_error", "consistency", "credibility"):
        table = pd.read_csv(result / f"{name}.csv")
        assert counts[f"/insdvl/table/{name}"] == len(table)
        for key, value in table.iloc[-1].items():
            shown = getattr(last[f"/insdvl/table/{name}"], str(key))
            assert shown == value or (value != value and (shown == "" or shown != shown)), key


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The last message of each topic."""
    folder = tmp_path_factory.mktemp("layouts")
    save_replay(
        replay_log(PROJECT / "sample_logs" / "straight.mcap", load_config("levy-klein")), folder
    )
    with (folder / "replay.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return {
            channel.topic: decoded for _, channel, _, decoded in reader.iter_decoded_messages()
        }


def is_number(message: Any, path: str) -> bool:
    """Whether a path such as ``position_ned_m[2]`` leads to a number."""
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", path):
        message = getattr(message, name)
        message = message[int(index)] if index else message
    return isinstance(message, float)


def leaves(layout: Any) -> Iterator[str]:
    """Panels of a mosaic."""
    if isinstance(layout, str):
        yield layout
        return
    assert layout["direction"] in {"row", "column"}
    yield from leaves(layout["first"])
    yield from leaves(layout["second"])


def test_every_path_of_the_foxglove_layout_is_a_number_of_a_replay(
    messages: dict[str, Any],
) -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text("utf-8"))
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) > 60
    for path in paths:
        topic, _, field = path.partition(".")
        assert is_number(messages[topic], field), path
    named = {panel["topicToRender"] for panel in panels.values() if "topicToRender" in panel} - {
        "/insdvl/notes"
    }
    named |= {topic for panel in panels.values() for topic in panel.get("topicColors", {})}
    assert named <= messages.keys()


def test_every_panel_of_the_foxglove_layout_is_on_one_tab() -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text("utf-8"))
    tabs = layout["configById"][layout["layout"]]["tabs"]
    assert [tab["title"] for tab in tabs] == ["predicted", "error", "innovation", "motion"]
    shown = [panel for tab in tabs for panel in leaves(tab["layout"])]
    assert sorted([*shown, layout["layout"]]) == sorted(layout["configById"])


def test_every_curve_of_the_plotjuggler_layout_is_a_number_of_a_replay(
    messages: dict[str, Any],
) -> None:
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    curves = [curve.get("name", "") for curve in root.iter("curve")]
    assert len(curves) > 60
    for curve in curves:
        topic, _, field = curve.rpartition("/")
        assert is_number(messages[topic], field), curve
    for splitter in root.iter("DockSplitter"):
        assert (
            int(splitter.get("count", ""))
            == len(splitter)
            == len(splitter.get("sizes", "").split(";"))
        )


def test_layouts_next_to_a_replay_name_its_filters() -> None:
    made = viewer_layouts(["plain", "windowed", "published"])
    for name, text in made.items():
        drawn = (LAYOUTS / name).read_text("utf-8")
        assert not re.search(r"\b(baseline|aided)\b", text)
        assert text.replace("windowed", "aided").replace("plain", "baseline") == drawn
