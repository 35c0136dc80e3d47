"""An observability study for people: ranks, what is unobservable in words and numbers, what is left of each state."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd

from insdvl_replay.report.shown import MISSING, ShownTable, number, percent, row_label
from insdvl_replay.states import STATES

_SHORT: Final = {
    "velocity + published": "velocity +\npublished",
    "velocity + windowed": "velocity +\nwindowed",
}
_NOTHING: Final = 1e-5
"""Smaller components of a direction, in shown units beside a leading 1, are left out."""


def observability_sentences(tables: Mapping[str, pd.DataFrame], tolerance: float) -> tuple[str, ...]:
    """Say for each aiding what its rank is and which directions it cannot see.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        ``ranks`` and ``directions``.
    tolerance : float
        Share of the largest singular value up to which one is called zero.

    Returns
    -------
    tuple of str
    """
    directions = tables["directions"]
    unseen = directions[directions["status"] == "unobservable"].groupby("aiding")["label"].agg(list)
    sentences = [_rank_sentence(row, unseen.get(row["aiding"], [])) for row in tables["ranks"].to_dict("records")]
    return (*sentences, f"Singular values up to {tolerance:.0e} of the largest count as zero.")


def _rank_sentence(row: Mapping[Any, Any], unseen: list[str]) -> str:
    rank = f"{row['aiding']}: rank {row['rank']} of {row['states']}"
    if row["weak"]:
        rank += f", {row['weak']} of them with a signal below the noise"
    if row["rank"] == row["states"]:
        return f"{rank}."
    names = [*unseen, *([f"{row['unnamed']} without a name"] if row["unnamed"] else [])]
    gap = "" if not np.isfinite(row["gap"]) else f", where the singular values fall by a factor of {row['gap']:.0e}"
    return f"{rank}{gap}; unobservable: {', '.join(names)}."


def shown_observability(tables: Mapping[str, pd.DataFrame]) -> tuple[ShownTable, ...]:
    """Turn the tables of a study into tables for people.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        ``directions``, ``catalogue``, ``singular_values`` and ``states``.

    Returns
    -------
    tuple of ShownTable
        The directions, with their numbers and how they are seen; singular values; what is left of each state.
    """
    return (
        _catalogue(tables["catalogue"]),
        _directions(tables["directions"]),
        _singular_values(tables["singular_values"]),
        _states(tables["states"]),
    )


def _catalogue(catalogue: pd.DataFrame) -> ShownTable:
    return ShownTable(
        "Directions of error that have a name, at the start",
        ("direction", "what it is", "made of"),
        "lll",
        tuple((row["direction"], row["label"], ", ".join(_components(row))) for row in catalogue.to_dict("records")),
    )


def _components(row: Mapping[Any, Any]) -> Iterator[str]:
    for state in STATES:
        if abs(row[state.id]) > _NOTHING:
            yield f"{state.id} {number(row[state.id])} {state.unit}"


def _directions(directions: pd.DataFrame) -> ShownTable:
    cells = {
        (row["direction"], row["aiding"]): MISSING
        if row["status"] == "unobservable"
        else number(row["signal_to_noise"])
        for row in directions.to_dict("records")
    }
    return _by_aiding(
        "How the directions are seen: signal to noise of an error as large as the prior",
        "direction",
        {name: name for name in directions["direction"].unique()},
        list(directions["aiding"].unique()),
        cells,
        f"{MISSING}: unobservable",
    )


def _singular_values(values: pd.DataFrame) -> ShownTable:
    cells = {(row["number"], row["aiding"]): number(row["singular_value"]) for row in values.to_dict("records")}
    return _by_aiding(
        "Singular values: signal to noise of twelve directions at right angles",
        "",
        {count: str(count) for count in values["number"].unique()},
        list(values["aiding"].unique()),
        cells,
    )


def _states(states: pd.DataFrame) -> ShownTable:
    cells = {(row["state"], row["aiding"]): percent(row["left_pct"]) for row in states.to_dict("records")}
    return _by_aiding(
        "What is left of the prior standard deviation at the start, without process noise",
        "state",
        {name: row_label(name) for name in states["state"].unique()},
        list(states["aiding"].unique()),
        cells,
    )


def _by_aiding(
    title: str,
    header: str,
    labels: Mapping[Any, str],
    aidings: list[str],
    cells: Mapping[tuple[Any, str], str],
    footnote: str = "",
) -> ShownTable:
    return ShownTable(
        title,
        (header, *(_SHORT.get(aiding, aiding) for aiding in aidings)),
        "l" + "r" * len(aidings),
        tuple((label, *(cells[key, aiding] for aiding in aidings)) for key, label in labels.items()),
        footnote,
    )
