"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

Preset = Annotated[
    str | None,
    typer.Option("--preset", metavar="NAME", help="Settings to start from: levy-klein (the default), fog, tactical, mems."),
]
Settings = Annotated[
    list[str],
    typer.Option("--set", metavar="KEY=VALUE", help="Change one setting, such as dvl.scale=1.01; may be repeated."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace what an earlier run wrote.")]
Verbose = Annotated[
    int,
    typer.Option("-v", "--verbose", count=True, help="Say every note; twice: also where in the code an error arose."),
]


def config_file_option(*names: str) -> Path:
    """Make the option that names a file of settings."""
    return typer.Option(*names, metavar="FILE", help="Settings to change, as TOML.")
