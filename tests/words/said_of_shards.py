"""Parts of shards that are no whole run."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from as_text import Cases, refusal

from insdvl_replay.batch.merge import plan_merge

DIVES = ("monday", "tuesday", "wednesday", "thursday")
Change = Callable[[dict[str, Any]], None]


def said_of_shards(folder: Path) -> Cases:
    """Return what a merge says of each fault in the second of two parts."""
    (folder / "empty").mkdir()
    yield "a folder that is not there", merged(folder, "nowhere")
    yield "a folder without a finished shard", merged(folder, "empty")
    parts = ["first", "second"]
    write(folder / "first", part(1))
    yield "a shard is missing", merged(folder, "first")
    write(folder / "third", {**part(1), "shards": 5})
    yield "four shards are missing", merged(folder, "third")
    write(folder / "copy", part(1))
    yield "a shard is there twice", merged(folder, "first", "copy")
    for name, change in CHANGES.items():
        content = part(2)
        change(content)
        write(folder / "second", content)
        yield name, merged(folder, *parts)
    (folder / "second" / "shard_2_of_2.json").write_text("half of i")
    yield "a file that was cut", merged(folder, *parts)


def merged(folder: Path, *parts: str) -> str:
    return refusal(plan_merge, [folder / name for name in parts], folder / "merged")


def part(number: int) -> dict[str, Any]:
    """The file of one of two shards."""
    dives = [{"name": name, "settings": "a0b1"} for name in DIVES]
    return {
        "kind": "shard",
        "tool": {"version": "2.0", "sources": "c2d3"},
        "versions": {"python": "3.13.1", "numpy": "2.4.0"},
        "shard": number,
        "shards": 2,
        "dives": dives,
        "noise": {"a0b1": "e4f5"},
        "results": dict.fromkeys(DIVES[number - 1 :: 2], "0123"),
        "failed": {},
    }


def write(folder: Path, content: dict[str, Any]) -> None:
    folder.mkdir(exist_ok=True)
    name = f"shard_{content['shard']}_of_{content['shards']}.json"
    (folder / name).write_text(json.dumps(content), "utf-8")


CHANGES: dict[str, Change] = {
    "another version": lambda content: content["tool"].update(version="2.1"),
    "another package": lambda content: content["versions"].update(numpy="2.3.0"),
    "another dive": lambda content: content["dives"].append(
        {"name": "friday", "settings": "a0b1"}
    ),
    "other settings": lambda content: content["dives"][2].update(settings="b1a0"),
    "another noise": lambda content: content["noise"].update(a0b1="f5e4"),
    "a dive that is in both": lambda content: content["results"].update(monday="0123"),
    "a dive that is in none": lambda content: content["results"].pop("tuesday"),
    "a dive that nobody planned": lambda content: content["results"].update(sunday="0123"),
    "a dive above its folder": lambda content: content["dives"][0].update(name="../monday"),
}
