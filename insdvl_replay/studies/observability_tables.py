"""The tables of an observability study, in shown units."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.states import STATES
from insdvl_replay.core.words import DirectionStatus
from insdvl_replay.nav.error_directions import ErrorDirection, name_unobservable
from insdvl_replay.nav.observability import Observability

_FACTORS = np.array([state.factor for state in STATES])


def observability_tables(
    found: Mapping[str, Observability],
    directions: tuple[ErrorDirection, ...],
    prior_sd: Floats,
    left_sd: Mapping[str, Floats],
) -> dict[str, pd.DataFrame]:
    """Lay out what was found.

    Parameters
    ----------
    found : mapping of str to Observability
        By aiding.
    directions : tuple of ErrorDirection
        Those that have a name.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.
    left_sd : mapping of str to ndarray, shape (12,)
        Those after the last ping, with process noise, by aiding.

    Returns
    -------
    dict of str to DataFrame
        ``ranks``: aiding, rank, states, gap, weak (observable directions whose signal is below the noise), unnamed
        (unobservable directions without a name).
        ``directions``: aiding, direction, label, signal_to_noise, status (``unobservable``, ``weak``, ``seen``).
        ``catalogue``: direction, label, and its 12 errors in shown units, the leading one 1.
        ``singular_values``: aiding, number, singular_value, left_without_noise_pct of the prior, and the direction's 12
        errors in shown units, as large as the prior.
        ``states``: aiding, state, unit, prior_sd, left_sd and left_pct of the prior after the last ping, with process
        noise, and left_without_noise_pct, what would be left without of the errors at the start.
    """
    named = {aiding: name_unobservable(one, directions, prior_sd) for aiding, one in found.items()}
    return {
        "ranks": _ranks(found, named),
        "directions": _directions(found, named, directions, prior_sd),
        "catalogue": _catalogue(directions, prior_sd),
        "singular_values": _singular_values(found, prior_sd),
        "states": _states(found, prior_sd, left_sd),
    }


def _ranks(found: Mapping[str, Observability], named: Mapping[str, tuple[ErrorDirection, ...]]) -> pd.DataFrame:
    rows = [
        (
            aiding,
            one.rank,
            len(STATES),
            one.gap,
            int(np.sum(one.singular_values[: one.rank] < 1.0)),
            len(STATES) - one.rank - len(named[aiding]),
        )
        for aiding, one in found.items()
    ]
    return pd.DataFrame(rows, columns=["aiding", "rank", "states", "gap", "weak", "unnamed"])


def _directions(
    found: Mapping[str, Observability],
    named: Mapping[str, tuple[ErrorDirection, ...]],
    directions: tuple[ErrorDirection, ...],
    prior_sd: Floats,
) -> pd.DataFrame:
    rows = []
    for aiding, one in found.items():
        for direction in directions:
            response = one.response(direction.scaled(prior_sd))
            status = DirectionStatus.WEAK if response < 1.0 else DirectionStatus.SEEN
            if direction in named[aiding]:
                status = DirectionStatus.UNOBSERVABLE
            rows.append((aiding, direction.id, direction.label, response, status))
    return pd.DataFrame(rows, columns=["aiding", "direction", "label", "signal_to_noise", "status"])


def _catalogue(directions: tuple[ErrorDirection, ...], prior_sd: Floats) -> pd.DataFrame:
    rows = []
    for direction in directions:
        shown = direction.error / _FACTORS
        leading = shown[np.argmax(np.abs(direction.scaled(prior_sd)))]
        rows.append((direction.id, direction.label, *(shown / leading)))
    return pd.DataFrame(rows, columns=["direction", "label", *(state.id for state in STATES)])


def _singular_values(found: Mapping[str, Observability], prior_sd: Floats) -> pd.DataFrame:
    rows = [
        (aiding, number, value, 100.0 / np.sqrt(1.0 + value**2), *(direction * prior_sd / _FACTORS))
        for aiding, one in found.items()
        for number, (value, direction) in enumerate(zip(one.singular_values, one.directions, strict=True), start=1)
    ]
    columns = ["aiding", "number", "singular_value", "left_without_noise_pct", *(state.id for state in STATES)]
    return pd.DataFrame(rows, columns=columns)


def _states(found: Mapping[str, Observability], prior_sd: Floats, left_sd: Mapping[str, Floats]) -> pd.DataFrame:
    tables = []
    for aiding, one in found.items():
        rows = pd.DataFrame([(aiding, state.id, state.unit) for state in STATES], columns=["aiding", "state", "unit"])
        rows["prior_sd"], rows["left_sd"] = prior_sd / _FACTORS, left_sd[aiding] / _FACTORS
        rows["left_pct"], rows["left_without_noise_pct"] = 100.0 * left_sd[aiding] / prior_sd, 100.0 * one.left()
        tables.append(rows)
    return pd.concat(tables, ignore_index=True)
