"""``simulate``, ``config``, ``schema`` and ``compile``: what prepares replays, and is prepared for them."""

import math
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from insdvl_replay.cli.messages import log_to_stderr, write_stdout
from insdvl_replay.cli.options import Force, Outages, Preset, Scenario, Settings, Verbose, grade_names, outage_spans
from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.states import SENSORS

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from insdvl_replay.sim.sensor_errors import LostBeam, SensorErrors

_SHORT_S = 10.0


def simulate(
    scenario: Scenario,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="LOG", help="The MCAP file to write.")],
    seed: Annotated[
        int, typer.Option(metavar="N", help="Of every sensor error; the same seed gives the same bytes.")
    ] = 1,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Seconds; left out, as long as the scenario is.")
    ] = None,
    imu: Annotated[
        str,
        typer.Option(metavar="GRADE", help="How good the IMU is: fog, tactical or mems.", autocompletion=grade_names),
    ] = "fog",
    outage: Outages = [],  # noqa: B006
    lost_beam: Annotated[
        list[str],
        typer.Option(
            metavar="BEAM:START:END",
            help="The same for one beam, counted from 0, which tables call beam_1. May be repeated.",
        ),
    ] = [],  # noqa: B006
    sensor: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=SD[@HZ]",
            help=f"{', '.join(SENSORS)}: its noise in m or deg, and its rate, else 1 Hz. May be repeated.",
        ),
    ] = [],  # noqa: B006
    lever_arm: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="From the IMU to the DVL, forward, starboard, down, m.")
    ] = "0,0,0",
    mounting: Annotated[
        str, typer.Option(metavar="R,P,H", help="How the DVL is turned: roll, pitch and heading, deg.")
    ] = "0,0,0",
    dvl_delay: Annotated[float, typer.Option(metavar="S", help="Seconds by which pings are stamped too late.")] = 0.0,
    dvl_scale: Annotated[float, typer.Option(metavar="TIMES", help="What the DVL reads over the velocity.")] = 1.0,
    force: Force = False,
    verbose: Verbose = 0,
) -> None:
    """Write a simulated dive as a log.

    Its reference is the exact motion, and it holds the true sensor biases.

    \b
    Example:
      insdvl-replay simulate figure-eight -o dive.mcap --imu tactical --seed 7
      insdvl-replay simulate straight -o dive.mcap --outage 60:90 --lost-beam 2:120:180
      insdvl-replay simulate lawnmower -o dive.mcap --imu mems --sensor depth=0.05@4
      insdvl-replay simulate calibration -o dive.mcap --lever-arm 0.3,-0.1,0.2 --mounting 0,0,1.5 --dvl-delay 0.12
    """
    from insdvl_replay.cli.screen import spinner
    from insdvl_replay.logs.writing.dive_log import write_dive
    from insdvl_replay.results.folder import result_file
    from insdvl_replay.sim.dive import simulate_dive

    with result_file(output, force=force) as path, spinner(f"simulating {scenario}"):
        dive = simulate_dive(
            scenario,
            seed=seed,
            duration_s=duration,
            grade=imu,
            outages=outage_spans(outage),
            lost_beams=[_lost_beam(text) for text in lost_beam],
            sensors=_sensors(sensor),
            lever_arm_m=_vector("--lever-arm", lever_arm),
            mounting_rpy_deg=_vector("--mounting", mounting),
            dvl_delay_s=dvl_delay,
            dvl_scale=dvl_scale,
        )
        write_dive(path, dive)
    log_to_stderr(f"wrote {output}")


def _vector(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"{option} {text}: is not three numbers", f"for example {option} 0.3,-0.1,0.2") from error
    if not all(map(math.isfinite, (x, y, z))):
        raise ConfigError(f"{option} {text}: is not finite", f"for example {option} 0.3,-0.1,0.2")
    return x, y, z


def _lost_beam(text: str) -> "LostBeam":
    from insdvl_replay.sim.sensor_errors import LostBeam

    try:
        beam, start_s, end_s = text.split(":")
        return LostBeam(int(beam), float(start_s), float(end_s))
    except ValueError as error:
        raise ConfigError(
            f"--lost-beam {text}: is not of the form BEAM:START:END", "for example --lost-beam 2:120:180"
        ) from error


def _sensors(texts: "Sequence[str]") -> "dict[str, SensorErrors]":
    found: dict[str, SensorErrors] = {}
    for text in texts:
        name, errors = _sensor(text)
        if name in found:
            raise ConfigError(f"--sensor {text}: there is a {name} already", "leave one of them out")
        found[name] = errors
    return found


def _sensor(text: str) -> "tuple[str, SensorErrors]":
    from insdvl_replay.sim.sensor_errors import SIMULATED, SensorErrors

    name, _, size = text.partition("=")
    require_known("--sensor", name, SIMULATED)
    sd, _, rate_hz = size.partition("@")
    try:
        errors = SensorErrors(float(sd), float(rate_hz or 1.0))
    except ValueError as error:
        raise ConfigError(f"--sensor {text}: is not of the form NAME=SD[@HZ]", f"--sensor {name}=0.1@4") from error
    if not (errors.sd > 0.0 and math.isfinite(errors.sd)):
        raise ConfigError(f"--sensor {text}: a noise of {sd} {SIMULATED[name].unit} cannot be", f"--sensor {name}=0.1")
    return name, errors


def config(
    preset: Preset = None,
    file: Annotated[
        list[Path],
        typer.Option(
            "-c", "--config", "--from", metavar="FILE", help="Settings as TOML, on top of the preset. May be repeated."
        ),
    ] = [],  # noqa: B006
    settings: Settings = [],  # noqa: B006
    verbose: Verbose = 0,
) -> None:
    """Print the resolved settings as commented TOML.

    It is ready to be edited and given to `run -c`. Precedence: defaults, then preset, then file, then --set.

    \b
    Example:
      insdvl-replay config --preset fog > vehicle.toml
      insdvl-replay config -c vehicle.toml --set dvl.scale=1.01
    """
    from insdvl_replay.core.config_file import load_config, render_toml

    write_stdout(render_toml(load_config(preset, file, settings, allow_code=True)))


def schema(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="config, report, inspection, study, comparison, check, calibration, or a message type; left out: all.",
        ),
    ] = None,
    verbose: Verbose = 0,
) -> None:
    """Print a JSON schema, or the definition of a ROS 2 message.

    \b
    Example:
      insdvl-replay schema report
      insdvl-replay schema insdvl_msgs/msg/NavSolution
    """
    from insdvl_replay.cli.json_schemas import SCHEMAS, json_schema

    if name is None:
        write_stdout("".join(f"{known}\n" for known in SCHEMAS))
    elif name in SCHEMAS:
        write_stdout(json_schema(name).decode())
    else:
        write_stdout(_message_definition(name, SCHEMAS))


def _message_definition(name: str, others: "Collection[str]") -> str:
    from insdvl_replay.core.errors import LogError, hint_for
    from insdvl_replay.logs.encoding.ros2msg import definition_text

    known = [*others, "a message type such as insdvl_msgs/msg/NavSolution"]
    try:
        return definition_text(name)
    except LogError as error:
        raise ConfigError(f"schema '{name}' is not known", hint_for(name, known, most=len(known))) from error


def compile_(verbose: Verbose = 0) -> None:
    """Compile the filter ahead of the first run, which else does it.

    The code is kept in ~/.cache/insdvl-replay, or where INSDVL_REPLAY_CACHE says. Runs with the same variable find it
    there, even where that folder cannot be written any more, as in a container.

    \b
    Example:
      insdvl-replay compile -v
      insdvl-replay compile
      INSDVL_REPLAY_CACHE=/opt/insdvl-replay insdvl-replay compile
    """
    from insdvl_replay.core.runtime import cache_folder, cache_problem, is_warm

    folder, start_s = cache_folder(), time.perf_counter()
    if problem := cache_problem():
        raise ConfigError(
            f"compiled code cannot be kept: {problem}", "INSDVL_REPLAY_CACHE=/a/folder/of/yours insdvl-replay compile"
        )
    was_warm = is_warm()
    with TemporaryDirectory() as name:
        _replay_something(Path(name) / "dive.mcap")
    took_s = time.perf_counter() - start_s
    write_stdout(
        visible(f"was compiled already: {folder}" if was_warm else f"compiled in {took_s:.1f} s: {folder}") + "\n"
    )


def _replay_something(log: Path) -> None:
    """Go through all that a run compiles."""
    from insdvl_replay.core.config import Config
    from insdvl_replay.logs import write_dive
    from insdvl_replay.replay import replay_log
    from insdvl_replay.sim.dive import simulate_dive

    write_dive(log, simulate_dive("straight", seed=1, duration_s=_SHORT_S))
    replay_log(log, Config())
