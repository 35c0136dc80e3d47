"""The pages of docs/reference/, by the program's own descriptions. `make reference` renews them; a test compares."""

import inspect
import json
import re
from collections.abc import Callable, Iterator, Mapping
from textwrap import fill
from typing import Any

import msgspec
import notes
import typer.main
from written import PROJECT, markdown_table

import insdvl_replay
from insdvl_replay.cli.app import app
from insdvl_replay.core.config import ConfigFile
from insdvl_replay.core.tables import ANSWERS, LAKE, LAYOUTS, TableLayout
from insdvl_replay.core.units import unit_of_name

FOLDER = PROJECT / "docs" / "reference"
NAME = "NAME"  # in the place of a name that the user chooses
SIGNS = {"sqrt(s)": "√s", "s2": "s²", "m3": "m³"}
"""How a page writes what is plain text elsewhere."""


def _cell(text: object) -> str:
    return " ".join(str(text).split()).replace("|", r"\|").replace("``", "`")


# --- The command line.


def command_line() -> str:
    """Write what `--help` says of each command."""
    head = (
        "# Command line\n\nEach command prints this text with `--help`. Results go to stdout. Everything else goes to"
        " stderr.\n\n[Comparing and CI](../comparing.md#exit-codes) lists the exit codes.\n"
    )
    return head + "".join(_command("insdvl-replay", typer.main.get_command(app)))


def _command(name: str, command: Any) -> Iterator[str]:
    below: Mapping[str, Any] = getattr(command, "commands", {})
    text, _, example = (
        inspect.cleandoc(command.help or "").replace("\b", "").partition("Example:\n")
    )
    context = command.make_context(name, [], resilient_parsing=True)
    records = [parameter.get_help_record(context) for parameter in command.get_params(context)]
    yield f"\n## {name}\n"
    first, _, more = text.strip().partition("\n\n")
    yield f"\n{' '.join(first.split())}\n"
    if more:
        yield f"\n```text\n{fill(' '.join(more.split()), 88)}\n```\n"
    if example:
        calls = "".join(f"$ {line.strip()}\n" for line in example.strip().splitlines())
        yield f"\n```console\n{calls}```\n"
    rows = [(f"`{_option(usage)}`", _cell(meaning)) for usage, meaning in filter(None, records)]
    yield f"\n{markdown_table(('argument or option', 'meaning'), rows)}\n"
    for child, found in below.items():
        yield from _command(f"{name} {child}", found)


def _option(usage: str) -> str:
    return re.sub(r" <(list\[)?(str|path|int|float)\]?>", "", usage).replace("|", r"\|")


# --- Settings.


def configuration() -> str:
    """Write every key of the settings, by the schema that checks them."""
    schema = msgspec.json.schema(ConfigFile)
    head = (
        "# Settings\n\nA settings file is TOML. `insdvl-replay config` prints all settings with these comments.\n\n"
        "A key ends in its unit. A key without a default may be left out. `frd` means forward-starboard-down. `flu`"
        " means forward-port-up. `sd` means standard deviation.\n"
    )
    return head + "".join(_section("", schema["$defs"]["ConfigFile"], schema["$defs"]))


def _section(name: str, section: Mapping[str, Any], known: Mapping[str, Any]) -> Iterator[str]:
    rows = []
    below = []
    for key, found in section["properties"].items():
        path = f"{name}.{key}".strip(".")
        inner = _reference(found)
        named = _reference(found.get("additionalProperties", {}))
        if "properties" in known.get(inner or named, {}):
            below.append((path if inner else f"{path}.{NAME}", known[inner or named]))
        else:
            rows.append(
                (
                    f"`{key}`",
                    _unit(key),
                    _default(key, found, section),
                    _cell(_meaning(found, known)),
                )
            )
    if rows:
        yield f"\n## `[{name}]`\n"
        yield f"\n{_sentence(section.get('description', ''))}\n"
        yield f"\n{markdown_table(('key', 'unit', 'default', 'meaning'), rows)}\n"
    for path, found in below:
        yield from _section(path, found, known)


def _reference(found: Mapping[str, Any]) -> str:
    """Return the name of the structure that a value must be, empty if it is none."""
    choices = [found, *found.get("anyOf", ())]
    return next((choice["$ref"].rsplit("/", 1)[1] for choice in choices if "$ref" in choice), "")


def _meaning(found: Mapping[str, Any], known: Mapping[str, Any]) -> str:
    text = found.get("description", "")
    words = next((c["enum"] for c in [found, *found.get("anyOf", ())] if "enum" in c), None)
    words = words or known.get(_reference(found), {}).get("enum")
    return text if text or not words else " | ".join(map(str, words))


def _default(key: str, found: Mapping[str, Any], section: Mapping[str, Any]) -> str:
    if "default" not in found:
        return "required" if key in section.get("required", ()) else ""
    return "" if found["default"] is None else f"`{json.dumps(found['default'])}`"


def _unit(key: str) -> str:
    unit = unit_of_name(key)
    for plain, sign in SIGNS.items():
        unit = unit.replace(plain, sign)
    return unit


def _sentence(text: str) -> str:
    return _cell(text).rstrip(".") + "." if text else ""


# --- Tables.


def tables() -> str:
    """Write every table and its columns."""
    head = (
        "# Tables\n\nEach table is a CSV file in the result folder. `report.json` has the same rows. `filters` is the"
        " first block of `report.json`. `lake` is the dataset of `run --lake`. `answers` is the"
        " `answers.csv` of several dives.\n\nA missing number is empty. It is"
        " never 0. The unit *row* means: column `unit` of the same row has the unit. A column without a meaning belongs"
        " to the column above.\n"
    )
    return head + "".join(part for layout in (*LAYOUTS, LAKE, ANSWERS) for part in _table(layout))


def _table(layout: TableLayout) -> Iterator[str]:
    yield f"\n## `{layout.name}`\n\n{_sentence(layout.about)}\n\n"
    comments = _comments(layout.row)
    rows = [
        (
            f"`{column}`",
            layout.kinds[column],
            layout.unit_of(column, "row"),
            found.better or "",
            _cell(found.comment) or comments.get(column, ""),
        )
        for column, found in layout.columns.items()
    ]
    yield f"{markdown_table(('column', 'type', 'unit', 'better', 'meaning'), rows)}\n"


# --- Python.


def python() -> str:
    """Write the public names, with their signatures."""
    head = "# Python\n\nThese names are public. All others may change.\n\n```python\nimport insdvl_replay\n```\n"
    names = sorted(name for name in insdvl_replay.__all__ if not name.startswith("_"))
    return head + "".join(
        part for name in names for part in _public(name, getattr(insdvl_replay, name))
    )


def _public(name: str, found: Any) -> Iterator[str]:
    yield f"\n## `{name}`\n\n{_first(found)}\n"
    if not isinstance(found, type):
        yield f"\n```python\n{_signature(name, found)}\n```\n"
        return
    comments = _comments(found)
    rows = [
        (f"`{field}`", _cell(_type(kind)), comments.get(field, ""))
        for field, kind in _annotations(found)
    ]
    for member, kind in sorted(vars(found).items()):
        if member.startswith("_") or not callable(getattr(kind, "fget", kind)):
            continue
        shown = member if isinstance(kind, property) else _signature(member, kind)
        rows.append(
            (
                f"`{shown}`".replace("|", r"\|"),
                "property" if isinstance(kind, property) else "method",
                _first(kind),
            )
        )
    if rows:
        yield f"\n{markdown_table(('member', 'type', 'meaning'), rows)}\n"


def _comments(found: type) -> dict[str, str]:
    """Return the comment of each field, by its name: behind it, or a single line above it.

    A sentence or several lines are about the fields that follow.
    """
    comments = {}
    above = ""
    is_block = False
    for line in inspect.getsource(found).splitlines():
        field = re.match(r"    (\w+): ", line)
        behind = re.search(r"  # (.+)$", line)
        if field and (behind or above):
            comments[field[1]] = _cell(behind[1] if behind else above)
        alone = re.fullmatch(r"    # (.+)", line)
        is_about_one = alone is not None and not is_block and not alone[1][0].isupper()
        above = alone[1] if alone and is_about_one else ""
        is_block = alone is not None
    return comments


def _annotations(found: type) -> Iterator[tuple[str, Any]]:
    yield from (
        (name, kind)
        for name, kind in inspect.get_annotations(found).items()
        if not name.startswith("_")
    )


def _type(kind: Any) -> str:
    text = kind if isinstance(kind, str) else getattr(kind, "__name__", str(kind))
    return f"`{text.removeprefix('pathlib.')}`"


def _signature(name: str, function: Callable[..., Any]) -> str:
    found = inspect.signature(function)
    kept = [parameter for key, parameter in found.parameters.items() if key != "self"]
    plain = re.sub(r"\b(?:\w+\.)+(\w+)", r"\1", str(found.replace(parameters=kept))).replace(
        "'", ""
    )
    return name + re.sub(r"ndarray\[tuple\[[^]]*\], dtype\[\w+\]\]", "ndarray", plain)


def _first(found: Any) -> str:
    return _cell((inspect.getdoc(found) or "").split("\n\n")[0])


PAGES: dict[str, Callable[[], str]] = {
    "command_line": command_line, "configuration": configuration, "tables": tables, "notes": notes.written,
    "python": python,
}  # fmt: skip


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for page, write in PAGES.items():
        (FOLDER / f"{page}.md").write_text(write(), "utf-8")
