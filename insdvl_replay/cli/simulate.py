"""``insdvl-replay simulate``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insdvl_replay.cli.completion import grade_names
from insdvl_replay.cli.messages import tell
from insdvl_replay.cli.options import Force, Outages, Scenario, Verbose, outage_spans
from insdvl_replay.core.errors import ConfigError

if TYPE_CHECKING:
    from insdvl_replay.sim.sensor_errors import LostBeam


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
        typer.Option(metavar="BEAM:START:END", help="The same for one beam, counted from 0. May be repeated."),
    ] = [],  # noqa: B006
    force: Force = False,
    verbose: Verbose = 0,
) -> None:
    """Write a simulated dive as a log.

    Its reference is the exact motion, and it holds the true sensor biases.

    \b
    Example:
      insdvl-replay simulate figure-eight -o dive.mcap --imu tactical --seed 7
      insdvl-replay simulate straight -o dive.mcap --outage 60:90 --lost-beam 2:120:180
    """
    from insdvl_replay.logs.writing.dive_log import write_dive
    from insdvl_replay.results.folder import result_file
    from insdvl_replay.sim.dive import simulate_dive

    with result_file(output, force=force) as path:
        dive = simulate_dive(
            scenario,
            seed=seed,
            duration_s=duration,
            grade=imu,
            outages=outage_spans(outage),
            lost_beams=[_lost_beam(text) for text in lost_beam],
        )
        write_dive(path, dive)
    tell(f"wrote {output}")


def _lost_beam(text: str) -> "LostBeam":
    from insdvl_replay.sim.sensor_errors import LostBeam

    try:
        beam, start_s, end_s = text.split(":")
        return LostBeam(int(beam), float(start_s), float(end_s))
    except ValueError as error:
        raise ConfigError(
            f"--lost-beam {text}: is not of the form BEAM:START:END", "for example --lost-beam 2:120:180"
        ) from error
