"""``insdvl-replay config``."""

from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli.messages import emit
from insdvl_replay.cli.options import Preset, Settings, Verbose


def config(
    preset: Preset = None,
    file: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="Settings as TOML, on top of the preset.")
    ] = None,
    settings: Settings = [],  # noqa: B006
    verbose: Verbose = 0,
) -> None:
    """Print the resolved settings as commented TOML.

    It is ready to be edited and given to `run -c`. Precedence: defaults, then preset, then file, then --set.

    \b
    Example:
      insdvl-replay config --preset fog > vehicle.toml
      insdvl-replay config --from vehicle.toml --set dvl.scale=1.01
    """
    from insdvl_replay.core.config_file import load_config, render_toml

    emit(render_toml(load_config(preset, file, settings)))
