"""Columns from JSON messages agree with the standard library's decoder, with a schema and without."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import block_of
from mcap.writer import Writer

from insdvl_replay.core.config import Config, Dvl, Imu
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.decoded import JsonReader

START_NS = 1_700_000_000_000_000_000
VECTOR = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
SCHEMA = json.dumps(
    {
        "type": "object",
        "properties": {
            "label": {"type": "string"},
            "count": {"type": "integer"},
            "rate": VECTOR,
            "beams": {
                "type": "array",
                "items": {"type": "object", "properties": {"velocity": {"type": "number"}}},
            },
        },
    }
).encode()


def columns(messages: list[Any], *paths: str, schema: bytes = b"") -> dict[str, Any]:
    texts = [
        message if isinstance(message, bytes) else json.dumps(message).encode()
        for message in messages
    ]
    return JsonReader("Ping", schema, paths).columns(block_of(texts))


def random_messages(count: int) -> list[Any]:
    rng = np.random.default_rng(5)
    return [
        {
            "label": "dvl",
            "count": int(rng.integers(2**53, 2**62)),
            "rate": {axis: rng.normal() for axis in "xyz"},
            "beams": [{"velocity": rng.normal()} for _ in range(4)],
        }
        for _ in range(count)
    ]


def test_columns_equal_what_was_serialised() -> None:
    messages = random_messages(30)
    beams = [[beam["velocity"] for beam in message["beams"]] for message in messages]
    for schema in (b"", SCHEMA):
        found = columns(
            messages,
            "count",
            "rate",
            "rate.y",
            "beams[*].velocity",
            "beams[1].velocity",
            schema=schema,
        )
        np.testing.assert_array_equal(
            found["count"][:, 0], [message["count"] for message in messages]
        )
        assert found["count"].dtype == np.int64
        np.testing.assert_array_equal(
            found["rate"], [list(message["rate"].values()) for message in messages]
        )
        np.testing.assert_array_equal(found["rate.y"], found["rate"][:, 1:2])
        np.testing.assert_array_equal(found["beams[*].velocity"], beams)
        np.testing.assert_array_equal(found["beams[1].velocity"][:, 0], [row[1] for row in beams])


def test_the_order_of_members_says_nothing() -> None:
    messages = [
        {"t": {"nanosec": 2, "sec": 1}, "v": {"z": 3.0, "x": 1.0, "y": 2.0}},
        {"v": {"y": 5, "z": 6, "x": 4}},
    ]
    found = columns(messages, "v", "t")
    np.testing.assert_array_equal(found["v"], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    np.testing.assert_array_equal(found["t"], [[1.0, 2.0], [np.nan, np.nan]])


def test_null_absent_and_text_are_nan_each_in_its_place() -> None:
    messages = [
        {"v": {"x": 1, "y": 2, "z": 3}},
        {"v": {"x": 1, "z": 3}},
        {"v": {"x": None, "y": "2", "z": True}},
        {},
        7,
    ]
    nan = np.nan
    expected = [[1, 2, 3], [1, nan, 3], [nan, nan, 1], [nan] * 3, [nan] * 3]
    np.testing.assert_array_equal(columns(messages, "v")["v"], expected)


def test_whole_numbers_of_any_size_are_read() -> None:
    found = columns([{"v": 2**62}, {"v": 10**30}, {"v": 10**400}], "v")["v"]
    np.testing.assert_array_equal(found, [[2.0**62], [1e30], [np.nan]])


def test_nonsense_is_refused_or_missing_but_never_a_traceback() -> None:
    schema = b'{"type": "object", "properties": [1], "items": 3}'
    np.testing.assert_array_equal(
        columns([{"v": 1.5}, [1], "v", None], "v", schema=schema)["v"][:2], [[1.5], [np.nan]]
    )
    for levels, sentence in ((400, "is text|has no field"), (100_000, "not JSON")):
        with pytest.raises(LogError, match=rf"{sentence}"):
            columns([b'{"v":' * levels + b"1" + b"}" * levels], ".".join("v" * 40))


def test_fields_that_only_later_messages_show_are_known() -> None:
    messages = [{"beams": [], "v": None}, {"beams": [{"velocity": 1.5}], "v": 2.0}]
    found = columns(messages, "beams[*].velocity", "v")
    np.testing.assert_array_equal(found["beams[*].velocity"], [[np.nan], [1.5]])
    np.testing.assert_array_equal(found["v"], [[np.nan], [2.0]])


def test_unknown_path_names_the_nearest_field_and_text_is_no_number() -> None:
    for path in ("rates", "beams.velocity"):
        with pytest.raises(LogError, match=rf"Ping has no field '{path}'") as raised:
            columns(random_messages(2), path)
        assert "the nearest one is" in raised.value.hint
    with pytest.raises(LogError, match="'label' of Ping is text"):
        columns(random_messages(2), "label")


def test_a_reader_of_other_fields_looks_at_no_message_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    block = block_of([b'{"a": 1, "b": {"c": [2, 3]}}', b'{"a": 4, "b": {"c": [5, 6]}}'])
    first = JsonReader("", b"", ())
    first.columns(block)
    monkeypatch.setattr(JsonReader, "learn", None)
    assert first.of(["b.c[1]"]).columns(block)["b.c[1]"].tolist() == [[3], [6]]
    assert first.of(["a"]).columns(block)["a"].tolist() == [[1], [4]]


def test_what_is_no_json_is_refused() -> None:
    with pytest.raises(LogError, match=r"a message of 10 bytes is not JSON") as raised:
        columns([b'{"v": 1 2}'], "v")
    assert "damaged" in raised.value.hint
    with pytest.raises(LogError, match="the JSON schema is no JSON"):
        columns([{}], "v", schema=b"{")


def test_a_dive_of_json_messages_is_read_by_field_paths(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        imu, dvl = (writer.register_channel(topic, "json", 0) for topic in ("imu", "dvl"))
        for i in range(200):
            reading = {"f": {"x": 0.0, "y": 0.0, "z": -1.0}, "w": [0.0, 0.0, i * 1e-3]}
            writer.add_message(imu, START_NS + i * 10**7, json.dumps(reading).encode(), 0)
        for i in range(10):
            ping = {
                "time_ms": START_NS // 10**6 + 200 * i,
                "beams": [{"v": 0.1 * i, "ok": j != i} for j in range(4)],
            }
            writer.add_message(dvl, START_NS + i * 2 * 10**8, json.dumps(ping).encode(), 0)
        writer.finish()
    config = Config(
        imu=Imu(topic="imu", specific_force="f", angular_rate="w", specific_force_unit="g"),
        dvl=Dvl(
            topic="dvl", beam_velocity="beams[*].v", beam_valid="beams[*].ok", stamp="time_ms"
        ),
    )
    dive = read_dive(path, config)
    np.testing.assert_allclose(
        dive.imu.specific_force_b, np.tile([0.0, 0.0, -9.80665], (200, 1)), rtol=1e-15
    )
    np.testing.assert_array_equal(dive.imu.angular_rate_b[:, 2], np.arange(200) * 1e-3)
    assert dive.dvl.beam_velocity_mps is not None
    np.testing.assert_array_equal(np.isnan(dive.dvl.beam_velocity_mps), np.eye(10, 4, dtype=bool))
    np.testing.assert_array_equal(dive.dvl.time_ns, START_NS + np.arange(10) * 2 * 10**8)


def test_a_message_without_its_stamp_is_left_out_wherever_it_is(tmp_path: Path) -> None:
    missing = [0, 100, 199]
    path, time_ns = tmp_path / "dive.mcap", START_NS + np.arange(200) * 10**7
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        imu, dvl = (writer.register_channel(topic, "json", 0) for topic in ("imu", "dvl"))
        for i, at_ns in enumerate(time_ns.tolist()):
            stamp = dict(zip(("sec", "nanosec"), divmod(at_ns, 10**9), strict=True))
            reading = {
                "t": None if i in missing else stamp,
                "f": [0.0, 0.0, -9.8],
                "w": [0.0, 0.0, i * 1e-3],
            }
            writer.add_message(imu, at_ns, json.dumps(reading).encode(), at_ns)
            writer.add_message(
                dvl, at_ns, json.dumps({"v": [1.0 + i * 1e-3, 0.0, 0.0]}).encode(), at_ns
            )
        writer.finish()
    config = Config(
        imu=Imu(topic="imu", specific_force="f", angular_rate="w", stamp="t"),
        dvl=Dvl(topic="dvl", velocity="v"),
    )
    dive = read_dive(path, config)
    assert [note.count for note in dive.notes if note.code == "imu_wrong_stamps"] == [3]
    np.testing.assert_allclose(
        dive.imu.time_ns, np.delete(time_ns, missing), rtol=0.0, atol=256.0
    )  # of a float64
