"""``simulate``, ``config``, ``schema``, ``explain``, ``compile`` and ``figure``."""

import math
import re
import time
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Final, Literal, TypeVar, get_args

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.messages import log_info, log_to_stderr, write_stdout
from insdvl_replay.core.errors import ConfigError, require_known, visible
from insdvl_replay.core.states import SENSORS
from insdvl_replay.show.plots import PaperPlot

if TYPE_CHECKING:
    import pandas as pd

    from insdvl_replay.sim.sensor_errors import SensorErrors

_Value = TypeVar("_Value")
_SHORT_S = 10.0
_PLOTS: Final[tuple[str, ...]] = get_args(PaperPlot)


def simulate(
    scenario: opt.Scenario,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="LOG", help="The MCAP file to write.")
    ],
    seed: Annotated[
        int, typer.Option(metavar="N", help="Random seed; the same seed gives the same bytes.")
    ] = 1,
    duration: Annotated[
        float | None,
        typer.Option(metavar="S", help="Duration in s (default: that of the scenario)."),
    ] = None,
    imu: Annotated[
        str,
        typer.Option(
            metavar="GRADE",
            help="IMU grade: fog, tactical or mems.",
            autocompletion=opt.grade_names,
        ),
    ] = "fog",
    outage: opt.Outages = [],
    lost_beam: Annotated[
        list[str],
        typer.Option(
            metavar="BEAM:START:END",
            help="Time span in seconds without one beam, counted from 0 (beam_1 in tables). May be repeated.",
        ),
    ] = [],
    sensor: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=SD[@HZ]",
            help=f"Add a sensor ({', '.join(SENSORS)}) with noise in m or deg, at HZ (default 1). May be repeated.",
        ),
    ] = [],
    lever_arm: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z", help="Lever arm from IMU to DVL: forward, starboard, down, m."
        ),
    ] = "0,0,0",
    mounting: Annotated[
        str, typer.Option(metavar="R,P,H", help="Mounting of the DVL: roll, pitch, heading, deg.")
    ] = "0,0,0",
    dvl_delay: Annotated[
        float, typer.Option(metavar="S", help="Delay of the ping stamps in s.")
    ] = 0.0,
    dvl_scale: Annotated[
        float, typer.Option(metavar="TIMES", help="Scale of the DVL: measured over true velocity.")
    ] = 1.0,
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
) -> None:
    """Write a simulated dive as a log.

    Its reference is the exact motion. It also contains the true sensor biases.

    \b
    Example:
      insdvl-replay simulate figure-eight -o dive.mcap --imu tactical --seed 7
      insdvl-replay simulate straight -o dive.mcap --outage 60:90 --lost-beam 2:120:180
      insdvl-replay simulate lawnmower -o dive.mcap --imu mems --sensor depth=0.05@4
      insdvl-replay simulate calibration -o dive.mcap --lever-arm 0.3,-0.1,0.2 --mounting 0,0,1.5 --dvl-delay 0.12
    """
    from insdvl_replay.cli.screen import progress
    from insdvl_replay.logs.write import write_dive
    from insdvl_replay.results.folder import result_file
    from insdvl_replay.sim.dive import simulate_dive
    from insdvl_replay.sim.sensor_errors import LostBeam

    def lost(text: str) -> LostBeam:
        beam, start_s, end_s = text.split(":")
        return LostBeam(int(beam), float(start_s), float(end_s))

    with result_file(output, force=force) as path, progress(f"simulating {scenario}"):
        dive = simulate_dive(
            scenario,
            seed=seed,
            duration_s=duration,
            grade=imu,
            outages=opt.outage_spans(outage),
            lost_beams=[
                _parsed(
                    lost,
                    f"--lost-beam {text}",
                    text,
                    "of the form BEAM:START:END",
                    "--lost-beam 2:120:180",
                )
                for text in lost_beam
            ],
            sensors=_sensors(sensor),
            lever_arm_m=_vector("--lever-arm", lever_arm),
            mounting_rpy_deg=_vector("--mounting", mounting),
            dvl_delay_s=dvl_delay,
            dvl_scale=dvl_scale,
        )
        write_dive(path, dive)
    log_to_stderr(f"wrote {output}")


def _parsed(
    parse: Callable[[str], _Value],
    option: str,
    text: str,
    form: str,
    example: str,
) -> _Value:
    try:
        return parse(text)
    except ValueError as error:
        raise ConfigError(f"{option}: is not {form}", f"for example {example}") from error


def _vector(option: str, text: str) -> tuple[float, float, float]:
    def parse(text: str) -> tuple[float, float, float]:
        x, y, z = (float(part) for part in text.split(","))
        return x, y, z

    example = f"{option} 0.3,-0.1,0.2"
    return _parsed(parse, f"{option} {text}", text, "three numbers", example)


def _sensors(texts: list[str]) -> "dict[str, SensorErrors]":
    from insdvl_replay.sim.sensor_errors import SIMULATED, SensorErrors

    found: dict[str, SensorErrors] = {}
    for text in texts:
        name, _, size = text.partition("=")
        require_known("--sensor", name, SIMULATED)
        sd, _, rate_hz = size.partition("@")
        try:
            errors = SensorErrors(float(sd), float(rate_hz or 1.0))
        except ValueError as error:
            raise ConfigError(
                f"--sensor {text}: is not of the form NAME=SD[@HZ]", f"--sensor {name}=0.1@4"
            ) from error
        if not (errors.sd > 0.0 and math.isfinite(errors.sd)):
            unit = SIMULATED[name].unit
            raise ConfigError(
                f"--sensor {text}: the noise must be above 0 {unit}, found {sd}",
                f"--sensor {name}=0.1",
            )
        if name in found:
            raise ConfigError(f"--sensor {text}: {name} is given twice", "leave one of them out")
        found[name] = errors
    return found


def config(
    preset: opt.Preset = None,
    file: Annotated[
        list[Path],
        typer.Option(
            "-c",
            "--config",
            "--from",
            metavar="FILE",
            help="TOML settings that override the preset. May be repeated.",
        ),
    ] = [],
    settings: opt.Settings = [],
    verbose: opt.Verbose = 0,
) -> None:
    """Print the resolved settings as commented TOML.

    Edit the output and pass it to `run -c`. Later layers override earlier ones: defaults, preset, files, --set.

    \b
    Example:
      insdvl-replay config --preset fog > vehicle.toml
      insdvl-replay config -c vehicle.toml --set dvl.scale=1.01
    """
    from insdvl_replay.core.config_file import SCHEMA_LINE, load_config, render_toml

    resolved = load_config(preset, file, settings, allow_code=True, report=log_info)
    write_stdout(SCHEMA_LINE + render_toml(resolved))


def schema(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="config, report, inspection, study, comparison, trajectories, check, calibration, or a message type "
            "(default: all).",
        ),
    ] = None,
    toml: Annotated[
        bool,
        typer.Option(
            "--toml", help="With config: print the first lines of a file of settings, for editors."
        ),
    ] = False,
    verbose: opt.Verbose = 0,
) -> None:
    """Print a JSON schema, or the definition of a ROS 2 message.

    \b
    Example:
      insdvl-replay schema report
      insdvl-replay schema config > insdvl-replay.schema.json
      insdvl-replay schema config --toml
      insdvl-replay schema insdvl_msgs/msg/NavSolution
    """
    from insdvl_replay.batch.schemas import lines_for_editors, schema_text

    if toml:
        write_stdout(lines_for_editors(name))
        return
    write_stdout(schema_text(name))


def explain(
    code: Annotated[
        str | None,
        typer.Argument(
            metavar="CODE", help="The code of a note, such as imu_gaps (default: list all)."
        ),
    ] = None,
    verbose: opt.Verbose = 0,
) -> None:
    """Explain the code of a note: meaning, effect and cure.

    \b
    Example:
      insdvl-replay explain imu_gaps
      insdvl-replay explain
    """
    from insdvl_replay.cli.screen import printed
    from insdvl_replay.core.notes import SOURCES, explanation, explanations
    from insdvl_replay.document.text import named_texts

    if code is not None:
        found = explanation(code)
        parts = {
            "what happened:": found.what,
            "effect:": found.effect,
            "what to do:": found.cure,
        }
        write_stdout(f"{visible(code)}\n")
        write_stdout(printed(named_texts(parts)))
        return
    subjects = explanations()
    widest = max(map(len, chain.from_iterable(subjects.values())))
    for subject, entries in subjects.items():
        texts = {code: entry.what for code, entry in entries.items()}
        write_stdout(f"{subject}\n")
        write_stdout(printed(named_texts(texts, widest)))
    write_stdout(f"* stands for a source: {', '.join(SOURCES)}\n")


def compile_(
    key: Annotated[
        bool,
        typer.Option(
            "--key",
            help="Compile nothing, and print a name of the compiled code for the cache of a job. It changes with "
            "sources, versions and processor.",
        ),
    ] = False,
    verbose: opt.Verbose = 0,
) -> None:
    """Compile the filter now, instead of in the first run.

    The compiled code is stored in ~/.cache/insdvl-replay, or in the folder INSDVL_REPLAY_CACHE. Runs with the same
    variable use it, even if the folder is read-only, as in a container.

    \b
    Example:
      insdvl-replay compile -v
      insdvl-replay compile
      INSDVL_REPLAY_CACHE=/opt/insdvl-replay insdvl-replay compile
      insdvl-replay compile --key
    """
    if key:
        from insdvl_replay.core.runtime import cache_key

        write_stdout(f"{cache_key()}\n")
    else:
        _compile_now()


def _compile_now() -> None:
    """Replay a short dive, which compiles everything that a run needs, and say how long it took."""
    from insdvl_replay.core.config import Config
    from insdvl_replay.core.runtime import (
        LEAST_TO_COMPILE_BYTES,
        cache_folder,
        cache_problem,
        is_warm,
        require_memory,
    )

    folder = cache_folder()
    start_s = time.perf_counter()
    was_warm = is_warm()
    if not was_warm:
        require_memory(LEAST_TO_COMPILE_BYTES)
    if problem := cache_problem():
        raise ConfigError(
            f"compiled code cannot be stored: {problem}",
            "INSDVL_REPLAY_CACHE=/a/folder/of/yours insdvl-replay compile",
        )
    from insdvl_replay.logs import write_dive
    from insdvl_replay.preparation.replay import replay_log
    from insdvl_replay.sim.dive import simulate_dive

    with TemporaryDirectory() as name:
        log = Path(name, "dive.mcap")
        write_dive(log, simulate_dive("straight", seed=1, duration_s=_SHORT_S))
        replay_log(log, Config())
    took = f"compiled in {time.perf_counter() - start_s:.1f} s"
    write_stdout(visible(f"{'already compiled' if was_warm else took}: {folder}") + "\n")


PictureFormat = Literal["pdf", "svg", "png", "pgf"]


def figure(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result folder.")],
    kind: Annotated[
        PaperPlot,
        typer.Argument(metavar="KIND", help=f"{', '.join(_PLOTS[:-1])} or {_PLOTS[-1]}."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Default: KIND with the format as ending, in this folder.",
        ),
    ] = None,
    format_: Annotated[PictureFormat, typer.Option("--format", help="pgf needs LaTeX.")] = "pdf",
    width: Annotated[
        str, typer.Option(metavar="MM", help="Width of the picture, such as 88mm for a column.")
    ] = "88mm",
    states: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="For sigma only: states, or the start of their names, such as ba,bg.",
        ),
    ] = "",
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
) -> None:
    """Draw a figure of a result for a paper.

    \b
    Example:
      insdvl-replay figure replay/dive error
      insdvl-replay figure replay/dive sigma --states ba,bg --width 180mm --format svg -o biases.svg
    """
    from insdvl_replay.core.report import StoredReport
    from insdvl_replay.document.paper import drawn
    from insdvl_replay.results.folder import TRAJECTORY_FILE, result_file
    from insdvl_replay.results.stored_results import read_one_result
    from insdvl_replay.results.trajectory import read_trajectory
    from insdvl_replay.show.plots.all_plots import chosen_states, paper_figure

    # What is wrong with the options is reported before anything is read.
    chosen = chosen_states(kind, states, f"--states {states}")
    width_mm = _width_mm(width)
    folder, report = read_one_result(result, StoredReport)
    trajectory = read_trajectory(folder / TRAJECTORY_FILE)
    if trajectory is None:
        raise ConfigError(
            f"{folder}: has no {TRAJECTORY_FILE} that can be read", "replay the log again"
        )

    def reference() -> "pd.DataFrame | None":
        from insdvl_replay.results.frames import stored_reference

        return stored_reference(folder, report.baseline)

    drawing = paper_figure(kind, trajectory, report.tables, chosen, reference)
    target = output or Path(f"{kind}.{format_}")
    if target.suffix != f".{format_}":
        ending = target.suffix.lstrip(".")
        known = get_args(PictureFormat)
        hint = (
            f"--format {ending}" if ending in known else f"-o {target.with_suffix(f'.{format_}')}"
        )
        raise ConfigError(f"{target}: does not end in .{format_}", hint)
    with result_file(target, force=force) as path:
        path.write_bytes(drawn(drawing, format_, width_mm))
    log_to_stderr(f"wrote {target}")


def _width_mm(text: str) -> float:
    from insdvl_replay.document.paper import require_width

    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?(?:mm)?", text)
    width_mm = float(found[1]) if found else math.nan
    require_width(width_mm, f"--width {text}")
    return width_mm
