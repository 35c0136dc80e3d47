"""``insdvl-replay schema``."""

from typing import Annotated

import typer

from insdvl_replay.cli.messages import emit
from insdvl_replay.cli.options import Verbose


def schema(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="config, report, inspection, study, comparison, check, or a message type; left out: those of JSON.",
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
        emit("".join(f"{known}\n" for known in SCHEMAS))
    elif name in SCHEMAS:
        emit(json_schema(name).decode())
    else:
        emit(_message_definition(name, ", ".join(SCHEMAS)))


def _message_definition(name: str, others: str) -> str:
    from insdvl_replay.core.errors import ConfigError, LogError
    from insdvl_replay.logs.encoding.ros2msg import definition_text

    try:
        return definition_text(name)
    except LogError as error:
        raise ConfigError(
            f"schema '{name}' is not known",
            f"known: {others}, and message types such as insdvl_msgs/msg/NavSolution",
        ) from error
