"""What a simulation can be asked for, and what it says to anything else."""

from collections.abc import Mapping, Sequence
from typing import Final, TypeVar

import numpy as np

from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.geometry.beams import AZIMUTH_DEG
from insdvl_replay.sim.sensor_errors import LostBeam

LONGEST_S: Final = 7 * 86400.0
"""No simulated dive is longer: a week at 100 Hz already fills 10 GB."""

T = TypeVar("T")


def named(kind: str, name: str, known: Mapping[str, T]) -> T:
    """Look a name up, or say which one was meant.

    Parameters
    ----------
    kind : str
        What it names, for the error.

    Returns
    -------
    anything
        What the name stands for.

    Raises
    ------
    ConfigError
        The name is not known.
    """
    require_known(kind, name, known)
    return known[name]


def check_duration(duration_s: float) -> None:
    """Require a duration above 0 that memory holds; a `ConfigError` else."""
    check_positive("duration", "s", duration_s)
    if duration_s > LONGEST_S:
        raise ConfigError(
            f"duration is {duration_s:g} s, and may be {LONGEST_S:g} s at most", f"--duration {LONGEST_S:g}"
        )


def check_positive(what: str, unit: str, value: float) -> None:
    """Require a number above 0; a `ConfigError` else."""
    if not 0.0 < value < np.inf:
        raise ConfigError(f"{what} is {value:g} {unit}, and must be above 0", f"give the {what} in {unit}")


def check_spans(spans: Sequence[LostBeam], duration_s: float) -> None:
    """Require beams that there are, lost inside the dive until after they were; a `ConfigError` else."""
    beams = len(AZIMUTH_DEG)
    for span in spans:
        if not span.start_s < span.end_s:
            raise ConfigError(
                f"an outage from {span.start_s:g} s to {span.end_s:g} s does not end after its start",
                "give its start first, then its end, in seconds from the start of the dive",
            )
        if span.start_s >= duration_s or span.end_s <= 0.0:
            raise ConfigError(
                f"an outage from {span.start_s:g} s to {span.end_s:g} s lies outside the dive, which lasts "
                f"{duration_s:g} s",
                "give its start and its end in seconds from the start of the dive, or a longer --duration",
            )
        if not 0 <= span.beam < beams:
            raise ConfigError(f"beam {span.beam} cannot be lost", f"beams are counted from 0 to {beams - 1}")
