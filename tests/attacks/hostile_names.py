"""File names, topics, types and attachments that mean something to a terminal, a page, a path or a build's log."""

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from content import Content, content_of, file_of
from fixed_harm import TEXTS
from mcap import records
from victim import Ended, run_forked, verdict

FILE_NAMES: tuple[bytes, ...] = (
    *(
        b"..mcap",
        b" .mcap",
        b"-o.mcap",
        b"--help.mcap",
        b"a b.mcap",
        b"*.mcap",
        b"[a].mcap",
        b"~.mcap",
        b"$(id).mcap",
    ),
    *(
        b"a\nb.mcap",
        b"a\rb.mcap",
        b"\x1b[31mred.mcap",
        b"\xff\xfe.mcap",
        "\u202efdp.mcap".encode(),
        b"a'b\"c.mcap",
    ),
    *(
        b"<script>alert(1)<.mcap",
        b"::error::x.mcap",
        b"%s%n{0}.mcap",
        b"=1+1.mcap",
        b"a" * 250 + b".mcap",
        b"a|b.mcap",
    ),
    *(
        b"report.json.mcap",
        b"index.html.mcap",
        b"CON.mcap",
        b"a\\b.mcap",
        b"{log}.mcap",
        b"#.mcap",
        b"a?b=c.mcap",
    ),
)
GATES = 'dives = ["*.mcap"]\n[[gate]]\nname = "any"\ntable = "improvement"\nrow = "ba_z"\ncolumn = "sd"\nmax = 1e9\n'
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f\x80-\x9f\u202a-\u202e\u2066-\u2069]")


def _judged(ended: Ended, printed: str, clean_mb: float, strangers: set[str]) -> str:
    judged = verdict(ended, clean_mb)
    if strangers:
        return "outside"
    if any(line.startswith("::") for line in (ended.said + printed).splitlines()):
        return "a command for the build"
    if judged == "ok" and CONTROL.search(ended.said + printed):
        return "control characters"
    return judged


def _logs(clean: bytes) -> Iterator[tuple[str, bytes, bytes]]:
    """Give what is hostile, the file's name and its content."""
    for name in FILE_NAMES:
        yield f"file {name.decode('utf-8', 'backslashreplace')!r}", name, clean
    for text in TEXTS:
        for what in ("topic", "second IMU", "type", "library", "attachment"):
            yield f"{what} {text[:30]!r}", b"dive.mcap", file_of(_named(clean, what, text))


def _named(clean: bytes, what: str, text: str) -> Content:
    content = content_of(clean)
    if what in ("topic", "second IMU"):
        place = next(
            place for place, channel in enumerate(content.channels) if channel.topic == "/imu"
        )
        imu = content.channels[place]
        if what == "topic":
            content.channels[place] = replace(imu, topic=text)
        else:
            content.channels.append(replace(imu, topic=f"/imu{text}", id=900))
            content.messages += [
                replace(message, channel_id=900)
                for message in content.messages
                if message.channel_id == imu.id
            ]
    elif what == "type":
        content.schemas[0] = replace(content.schemas[0], name=text)
    elif what == "library":
        content.header = replace(content.header, library=text)
    else:
        content.others += [
            records.Attachment(0, 0, text, text, b"x"),
            records.Metadata(text, {text: text}),
        ]
    return content


def attack(
    folder: Path, clean: bytes, clean_mb: float, only: str
) -> Iterator[tuple[str, str, str, Ended]]:
    """Try each name with `run`, `inspect` and `check`; nothing may appear but results where they belong."""
    for what, name, data in _logs(clean):
        if only not in what:
            continue
        place = folder / "names"
        (place / "logs").mkdir(parents=True)
        (place / "logs" / "gates.toml").write_text(GATES, "utf-8")
        log = os.fsencode(place / "logs") + b"/" + name
        with open(log, "wb") as stream:  # noqa: PTH123
            stream.write(data)
        path, output = os.fsdecode(log), str(place / "results")
        check = [
            "check",
            str(place / "logs" / "gates.toml"),
            "--results",
            output,
            "--format",
            "github",
        ]
        for command in (
            ["run", path, "-o", output, "--force", "--rerun"],
            ["inspect", path],
            check,
        ):
            ended = run_forked(command, folder / "said", folder / "printed")
            there = {
                entry.name for folder in (place, place / "logs") for entry in folder.iterdir()
            }
            strangers = there - {"logs", "results", "gates.toml", os.fsdecode(name)}
            printed = (
                "" if command is check else (folder / "printed").read_text("utf-8", "replace")
            )
            yield what, command[0], _judged(ended, printed, clean_mb, strangers), ended
        shutil.rmtree(place)
