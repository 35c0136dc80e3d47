"""Options that several commands share, and the allowed values of options."""

import re
import shlex
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import typer
from typer.core import TyperCommand, TyperGroup

from insdvl_replay.core.dive_record import TABLE_SUFFIXES
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.path_kinds import PAGES, looks_like_log, result_named
from insdvl_replay.core.runtime import require_memory

_SMALL: Final = ("config", "schema", "explain")
"""Commands that load neither numpy nor the compiler."""


class PlainCommand(TyperCommand):
    """A command whose help omits type names of Python, such as list[str]."""

    def get_help(self, ctx: typer.Context) -> str:  # type: ignore[override]
        """Return the help."""
        return re.sub(r" <list\[\w+\]>", lambda kind: " " * len(kind[0]), super().get_help(ctx))

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        """Run the command, if the process may take the memory that its libraries need."""
        if self.name not in _SMALL:
            require_memory()
        return super().invoke(ctx)


class PlainGroup(TyperGroup):
    """A group of commands that says what was meant where a path is given instead of a command."""

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        """Return the command that the first argument names."""
        if args and args[0] not in self.commands:
            _raise_if_path(args)
        return super().resolve_command(ctx, args)


def _raise_if_path(args: list[str]) -> None:
    """Raise a ConfigError, with the command that was probably meant, if the first argument is a path and no command."""
    path = Path(args[0])
    typed = " ".join(map(shlex.quote, args))
    hint = ""
    if (folder := result_named(path)) is not None:
        hint = f"it is a result: open {folder / PAGES[0]}, or `insdvl-replay compare OLD {shlex.quote(args[0])}`"
    elif path.suffix == ".toml" and path.is_file():
        hint = (
            f"settings: `insdvl-replay run LOG -c {typed}`; gates: `insdvl-replay check {typed}`"
        )
    elif looks_like_log(path) or path.exists() or path.suffix.lower() in TABLE_SUFFIXES:
        hint = f"did you mean `insdvl-replay run {typed}`?"
    if hint:
        raise ConfigError(f"{args[0]}: is a path, where a command is expected", hint)


def _names(module: str, names: str) -> Callable[[str], list[str]]:
    """Return a completion by the names in a module, which is imported on completion only."""

    def beginning(incomplete: str) -> list[str]:
        known = getattr(import_module(f"insdvl_replay.{module}"), names)
        return [name for name in known if name.startswith(incomplete)]

    return beginning


grade_names = _names("sim.sensor_errors", "GRADES")
Format = Literal["table", "json", "csv", "md", "latex"]
PageFormat = Literal["table", "json", "csv", "md", "latex", "html"]
CheckFormat = Literal["text", "md", "json", "junit", "github", "html"]
Color = Literal["auto", "always", "never"]

PrintedAs = Annotated[Format, typer.Option("--format", help="Output format.")]
Preset = Annotated[
    str | None,
    typer.Option(
        "--preset",
        metavar="NAME",
        help="Settings to start from: levy-klein (the paper's), fog, tactical or mems.",
        autocompletion=_names("core.config_file", "PRESETS"),
    ),
]
Logs = Annotated[
    list[str],
    typer.Argument(
        metavar="LOG...",
        help="Logs (.mcap, .db3, .bag), bags, tables, folders of them, quoted patterns, .txt lists, manifests, URLs.",
    ),
]
Start = Annotated[
    float | None,
    typer.Option("--start", metavar="T", help="Start here, in seconds from the first IMU sample."),
]
End = Annotated[
    float | None,
    typer.Option("--end", metavar="T", help="End here, in seconds from the first IMU sample."),
]
Offline = Annotated[
    bool,
    typer.Option(
        "--offline",
        help="Fetch nothing: of URLs, use the logs that earlier commands have fetched.",
    ),
]
AllowDamaged = Annotated[
    bool,
    typer.Option(
        "--allow-damaged",
        help="Use the readable part of a damaged log; a note counts what is lost.",
    ),
]
AllowCode = Annotated[
    bool,
    typer.Option(
        "--allow-code",
        help="Run the code that the settings name (module:Class), with your permissions.",
    ),
]
OneDive = Annotated[
    bool,
    typer.Option(
        "--one-dive",
        help="Read all files as one dive. Its name is that of the first file in alphabetical order.",
    ),
]
Scenario = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="straight, figure-eight, lawnmower, static or calibration.",
        autocompletion=_names("sim.trajectories", "SCENARIOS"),
    ),
]
Settings = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one setting, such as dvl.scale=1.01. May be repeated.",
    ),
]
ConfigFiles = Annotated[
    list[Path],
    typer.Option(
        "-c",
        "--config",
        metavar="FILE",
        help="TOML settings that override the preset. Later files override earlier ones; the filters of all are kept.",
    ),
]
NoConfig = Annotated[
    bool,
    typer.Option(
        "--no-config",
        help="Ignore insdvl-replay.toml in the folder of a dive and above it. With -c it is ignored, too.",
    ),
]
Outages = Annotated[
    list[str],
    typer.Option(
        "--outage",
        metavar="START:END",
        help="Time span in seconds without bottom track. May be repeated.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace what an earlier run wrote.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit with 3 if there is any warning.")]
Shard = Annotated[
    str | None,
    typer.Option(
        "--shard",
        metavar="I/N",
        help="Only every N-th dive, starting at the I-th, counted by their names.",
    ),
]
Results = Annotated[
    Path,
    typer.Option(
        "-o",
        "--output",
        metavar="DIR",
        help="Output folder; each log gets a subfolder with its name.",
    ),
]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs", metavar="N", min=1, help="Number of parallel processes, one dive each."
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDR",
        help="Replay on the dask.distributed cluster at this address.",
    ),
]
FailOn = Annotated[
    str | None,
    typer.Option(
        "--fail-on",
        metavar="worse|undecided|P%",
        help="Exit with 1 if the answer for a filter is worse, or not decided either, or if any value is worse by more "
        "than P%.",
    ),
]
Rerun = Annotated[
    bool, typer.Option("--rerun", help="Replay all dives, also those whose result is up to date.")
]
Verbose = Annotated[
    int,
    typer.Option(
        "-v",
        "--verbose",
        count=True,
        show_default=False,
        help="Print more; twice (-vv), also the traceback of an error.",
    ),
]


Quiet = Annotated[
    bool, typer.Option("-q", "--quiet", help="Print less: the verdict in one line, and errors.")
]


def _choose_color(color: Color) -> Color:
    from insdvl_replay.cli.screen import Colors

    Colors.wanted = None if color == "auto" else color == "always"
    return color


Colored = Annotated[
    Color,
    typer.Option(
        "--color",
        callback=_choose_color,
        help="Color the verdicts: auto (on a terminal, unless NO_COLOR is set), always or never.",
    ),
]
ChosenTables = Annotated[
    list[str],
    typer.Option(
        "--table",
        metavar="NAME",
        help="Print only this table, with all rows; answers, pooled and summary are over all dives. May be repeated.",
    ),
]


def require_no_table_over_dives(tables: Sequence[str], dive: str) -> None:
    """Raise a ConfigError where a table over dives is asked for that one dive cannot fill."""
    for name in ("answers", "pooled"):
        if name in tables:
            raise ConfigError(f"--table {name}: {dive} is one dive", "name two dives or more")


def span_settings(start: float | None, end: float | None, starts: int | None = None) -> list[str]:
    """Return ``--start``, ``--end`` and ``--starts`` as settings."""
    given = {"span.start_s": start, "span.end_s": end, "evaluation.starts": starts}
    return [f"{key}={value!r}" for key, value in given.items() if value is not None]


def outage_spans(texts: list[str]) -> list[tuple[float, float]]:
    """Parse the values of ``--outage``."""
    spans = []
    for text in texts:
        try:
            start_s, end_s = (float(part) for part in text.split(":"))
        except ValueError as error:
            raise ConfigError(
                f"--outage {text}: is not of the form START:END", "for example --outage 60:90"
            ) from error
        spans.append((start_s, end_s))
    return spans
