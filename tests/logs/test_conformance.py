"""The official conformance suite of MCAP: each file holds what its list of expected records says."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl_replay.logs.formats.log_file import gather
from insdvl_replay.logs.formats.mcap_file import McapFile
from insdvl_replay.logs.formats.recording import Recording, open_recording

SUITE = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "mcap_conformance"
FILES = 416

pytestmark = pytest.mark.skipif(
    not SUITE.is_dir(), reason="the conformance suite in ../shared/data is not here"
)


def expected_records(path: Path) -> dict[str, list[dict[str, Any]]]:
    records: dict[str, list[dict[str, Any]]] = {}
    for record in json.loads(path.with_suffix(".json").read_text())["records"]:
        records.setdefault(record["type"], []).append(dict(record["fields"]))
    return records


def numbers(texts: list[str]) -> bytes:
    return bytes(int(text) for text in texts)


@pytest.mark.parametrize(
    "every", [pytest.param(1, marks=pytest.mark.nightly, id="all"), pytest.param(29, id="few")]
)
def test_every_file_gives_the_expected_records(every: int) -> None:
    paths = sorted(SUITE.glob("*/*.mcap"))
    assert len(paths) == FILES
    for path in paths[::every]:
        log, expected = open_recording(path), expected_records(path)
        (file,) = log.parts
        assert_definitions(file, expected)
        assert_messages(log, expected)
        assert_files(file, expected)
        assert len(log.sha256()) == 64
        assert log.notes == ()


def assert_definitions(log: McapFile, expected: dict[str, list[dict[str, Any]]]) -> None:
    schemas = {
        int(s["id"]): (s["name"], s["encoding"], numbers(s["data"]))
        for s in expected.get("Schema", [])
    }
    assert {i: (s.name, s.encoding, s.data) for i, s in log.schemas.items()} == schemas
    channels = {
        int(c["id"]): (
            c["topic"],
            c["message_encoding"],
            schemas.get(int(c["schema_id"]), ("", "", b"")),
        )
        for c in expected.get("Channel", [])
    }
    found = {
        c.id: (c.topic, c.encoding, (c.type_name, c.schema_encoding, c.schema_data))
        for c in log.channels
    }
    assert found == channels
    assert {c.id: c.metadata for c in log.channels} == {
        int(c["id"]): c["metadata"] for c in expected.get("Channel", [])
    }


def assert_messages(log: Recording, expected: dict[str, list[dict[str, Any]]]) -> None:
    fields = ("channel_id", "sequence", "log_time", "publish_time")
    messages = expected.get("Message", [])
    found = []
    for block in log.blocks({channel.id for channel in log.channels}):
        sequence = gather(block.buffer, block.offsets - 20, np.dtype("<u4"))
        columns = block.offsets, block.sizes, sequence, block.log_time, block.publish_time
        found += [
            (block.channel_id, *values, bytes(block.buffer[offset : offset + size]))
            for offset, size, *values in zip(*columns, strict=True)
        ]
    assert found == [
        (*(int(message[name]) for name in fields), numbers(message["data"]))
        for message in messages
    ]
    assert sum(channel.messages for channel in log.channels) == len(messages)


def assert_files(log: McapFile, expected: dict[str, list[dict[str, Any]]]) -> None:
    metadata = [(record["name"], record["metadata"]) for record in expected.get("Metadata", [])]
    assert [(record.name, record.metadata) for record in log.metadata] == metadata
    attachments = [
        (a["name"], a["media_type"], int(a["log_time"]), int(a["create_time"]), numbers(a["data"]))
        for a in expected.get("Attachment", [])
    ]
    assert [
        (
            a.name,
            a.media_type,
            a.log_time,
            a.create_time,
            bytes(log.file.read(a.offset, a.offset + a.length)),
        )
        for a in log.attachments
    ] == attachments
