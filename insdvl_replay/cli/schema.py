"""``insdvl-replay schema``."""

from typing import Annotated

import typer

from insdvl_replay.cli.messages import emit


def schema(
    name: Annotated[str, typer.Argument(help="config, report, or a message type such as insdvl_msgs/msg/NavSolution.")],
) -> None:
    """Print a schema: JSON schema of the settings or of report.json, or the definition of a ROS 2 message.

    \b
    Example:
      insdvl-replay schema report
      insdvl-replay schema insdvl_msgs/msg/NavSolution
    """
    from insdvl_replay.errors import ConfigError, LogError
    from insdvl_replay.logs.ros2msg import definition_text
    from insdvl_replay.report.json_schemas import SCHEMAS

    if name in SCHEMAS:
        emit(SCHEMAS[name]().decode())
        return
    try:
        emit(definition_text(name))
    except LogError as error:
        known = f"known: {', '.join(SCHEMAS)}, and message types such as insdvl_msgs/msg/NavSolution"
        raise ConfigError(f"schema '{name}' is not known", known) from error
