"""What the shell offers for words that the program knows; loaded only when Tab is pressed."""

from collections.abc import Iterable


def preset_names(incomplete: str) -> list[str]:
    """Give the presets that begin with what is typed."""
    from insdvl_replay.core.config_file import PRESETS

    return _beginning(incomplete, PRESETS)


def scenario_names(incomplete: str) -> list[str]:
    """Give the scenarios that begin with what is typed."""
    from insdvl_replay.sim.trajectories import SCENARIOS

    return _beginning(incomplete, SCENARIOS)


def grade_names(incomplete: str) -> list[str]:
    """Give the grades of IMUs that begin with what is typed."""
    from insdvl_replay.sim.sensor_errors import GRADES

    return _beginning(incomplete, GRADES)


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
