"""``insdvl-replay figure``."""

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli.options import Force, Verbose
from insdvl_replay.core.errors import ConfigError

NARROWEST_MM, WIDEST_MM = 20.0, 1000.0


class Kind(StrEnum):
    """What is drawn."""

    ERROR = "error"
    TRACK = "track"
    SIGMA = "sigma"
    NIS = "nis"
    COASTING = "coasting"
    CONVERGENCE = "convergence"


class PictureFormat(StrEnum):
    """The format of a picture."""

    PDF = "pdf"
    SVG = "svg"
    PNG = "png"
    PGF = "pgf"


def figure(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result folder.")],
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help="error, track, sigma, nis, coasting or convergence.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Left out: KIND and the format, here.")
    ] = None,
    format_: Annotated[PictureFormat, typer.Option("--format", help="pgf needs LaTeX.")] = PictureFormat.PDF,
    width: Annotated[str, typer.Option(metavar="MM", help="Of the picture, such as 88mm for a column.")] = "88mm",
    states: Annotated[
        str, typer.Option(metavar="NAMES", help="Of sigma: states, or beginnings of their names, such as ba,bg.")
    ] = "",
    force: Force = False,
    verbose: Verbose = 0,
) -> None:
    """Draw what a paper prints of a result: a picture that stands on its own.

    \b
    Example:
      insdvl-replay figure replay/dive error
      insdvl-replay figure replay/dive sigma --states ba,bg --width 180mm --format svg -o biases.svg
    """
    from insdvl_replay.cli.messages import log_to_stderr
    from insdvl_replay.core.stored_report import StoredReport
    from insdvl_replay.results.folder import TRAJECTORY_FILE, result_file
    from insdvl_replay.results.paper_figures import Drawn, chosen_states, draw_figure
    from insdvl_replay.results.stored_results import read_one_result
    from insdvl_replay.results.trajectory import read_trajectory

    if states and kind is not Kind.SIGMA:
        raise ConfigError(
            f"--states {states}: chooses what sigma draws, and {kind.value} draws no states", "leave it out"
        )
    chosen, width_mm = chosen_states(states), _width_mm(width)
    folder, report = read_one_result(result, StoredReport)
    trajectory = read_trajectory(folder / TRAJECTORY_FILE)
    if trajectory is None:
        raise ConfigError(f"{folder}: has no {TRAJECTORY_FILE} that can be read", "replay the log again")
    target = output or Path(f"{kind.value}.{format_.value}")
    if target.suffix != f".{format_.value}":
        ending = target.suffix.lstrip(".")
        known = list(PictureFormat)
        hint = f"--format {ending}" if ending in known else f"-o {target.with_suffix(f'.{format_.value}')}"
        raise ConfigError(f"{target}: does not end in .{format_.value}", hint)
    with result_file(target, force=force) as path:
        drawn = Drawn(trajectory, report.tables.get("coasting", []), chosen)
        draw_figure(kind.value, drawn, path, width_mm=width_mm)
    log_to_stderr(f"wrote {target}")


def _width_mm(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?(?:mm)?", text)
    if found is None or not NARROWEST_MM <= float(found[1]) <= WIDEST_MM:
        raise ConfigError(f"--width {text}: is no width from {NARROWEST_MM:g} to {WIDEST_MM:g} mm", "--width 88mm")
    return float(found[1])
