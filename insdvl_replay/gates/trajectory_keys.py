"""The keys of a gate on the trajectory: against its baseline, or over time."""

from typing import Final

from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.core.states import COLUMNS, GROUPS
from insdvl_replay.gates.model import ANY, Gate

OF_TIME: Final = ("within", "share_pct", "longest_outside_s", "at_s")
"""Keys of conditions over time."""


def is_over_time(gate: Gate) -> bool:
    """Return whether a gate holds a quantity in a band, and not the whole trajectory against its baseline."""
    return gate.within is not None


def check_trajectory_gate(gate: Gate) -> None:
    """Raise a ConfigError if the keys of a gate on the trajectory do not go together."""
    if gate.column or gate.min is not None or gate.max is not None or gate.equals is not None:
        raise ConfigError(
            f"'{gate.name}': a trajectory has samples and no columns",
            'baseline = "baselines/{log}.npz", or within = [0.0, 2.0] with share_pct = 95',
        )
    if is_over_time(gate):
        if gate.baseline is not None or gate.max_abs:
            raise ConfigError(f"'{gate.name}': within stands beside a baseline", "make two gates of it")
        require_known("row", gate.row, COLUMNS)
        if gate.within is not None and not gate.within[0] <= gate.within[1]:
            raise ConfigError(f"'{gate.name}': within = {list(gate.within)} holds no value", "exchange its ends")
        return
    if gate.baseline is None:
        hint = 'baseline = "baselines/{log}.npz", or within = [0.0, 2.0] with share_pct = 95'
        raise ConfigError(f"'{gate.name}' has no condition", hint)
    require_known("row", gate.row, [ANY, *GROUPS, *COLUMNS])
    for column in gate.max_abs:
        require_known("max_abs", column, COLUMNS)
