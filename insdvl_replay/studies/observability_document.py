"""An observability study for people: ranks, what is unobservable in words and numbers, what is left of each state."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd

from insdvl_replay.core.quantities import label
from insdvl_replay.core.states import STATES
from insdvl_replay.core.words import DirectionStatus
from insdvl_replay.report.document import MISSING, DisplayTable, number, percent
from insdvl_replay.report.plots.panel import LIMIT, Curve, Figure, Panel, filter_style

_SHORT: Final = {
    "velocity + published": "velocity +\npublished",
    "velocity + windowed": "velocity +\nwindowed",
}
_NOTHING: Final = 1e-5
"""Smaller components of a direction, in display units beside a leading 1, are left out."""
_SMALLEST: Final = 1e-12
"""Singular values are drawn down to this share of the largest; below is rounding."""
_GROWN_PCT: Final = 101.0
"""Of the prior, above which a state is said to have grown more uncertain; a bias alone wanders by less."""


def observability_sentences(tables: Mapping[str, pd.DataFrame], tolerance: float) -> tuple[str, ...]:
    """State for each aiding its rank, which directions it cannot see, and which states it lets grow uncertain."""
    directions = tables["directions"]
    unseen = directions[directions["status"] == DirectionStatus.UNOBSERVABLE].groupby("aiding")["label"].agg(list)
    sentences = [_rank_sentence(row, unseen.get(row["aiding"], [])) for row in tables["ranks"].to_dict("records")]
    sentences += [_grown_sentence(aiding, rows) for aiding, rows in tables["states"].groupby("aiding", sort=False)]
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


def _grown_sentence(aiding: object, states: pd.DataFrame) -> str:
    """Name the states that are less certain at the end than at the start, which no rank shows."""
    grown = states[states["left_pct"] > _GROWN_PCT]
    names = [f"{label(row['state'])} ({row['left_pct']:.0f} %)" for row in grown.to_dict("records")]
    if not names:
        return f"{aiding}: with process noise, no state is less certain after the last ping than at the start."
    return f"{aiding}: with process noise, less certain after the last ping than at the start: {'; '.join(names)}."


def observability_display(tables: Mapping[str, pd.DataFrame]) -> tuple[DisplayTable, ...]:
    """Turn the tables of a study into tables for people."""
    return (
        _catalogue(tables["catalogue"]),
        _directions(tables["directions"]),
        _singular_values(tables["singular_values"]),
        _states(
            "What is left of the prior standard deviation after the last ping, process noise included",
            tables["states"],
            "left_pct",
            "Over 100 %: grown since the start, by process noise and by other errors",
        ),
        _states(
            "What would be left of the errors at the start, were there no process noise",
            tables["states"],
            "left_without_noise_pct",
        ),
    )


def _catalogue(catalogue: pd.DataFrame) -> DisplayTable:
    return DisplayTable(
        "Directions of error that have a name, at the start",
        ("direction", "what it is", "made of"),
        "lll",
        tuple((row["direction"], row["label"], ", ".join(_components(row))) for row in catalogue.to_dict("records")),
    )


def _components(row: Mapping[Any, Any]) -> Iterator[str]:
    for state in STATES:
        if abs(row[state.id]) > _NOTHING:
            yield f"{state.id} {number(row[state.id])} {state.unit}"


def _directions(directions: pd.DataFrame) -> DisplayTable:
    cells = {
        (row["direction"], row["aiding"]): MISSING
        if row["status"] == DirectionStatus.UNOBSERVABLE
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


def _singular_values(values: pd.DataFrame) -> DisplayTable:
    cells = {(row["number"], row["aiding"]): number(row["singular_value"]) for row in values.to_dict("records")}
    return _by_aiding(
        "Singular values: signal to noise of twelve directions at right angles",
        "",
        {count: str(count) for count in values["number"].unique()},
        list(values["aiding"].unique()),
        cells,
    )


def _states(title: str, states: pd.DataFrame, column: str, footnote: str = "") -> DisplayTable:
    cells = {(row["state"], row["aiding"]): percent(row[column]) for row in states.to_dict("records")}
    return _by_aiding(
        title,
        "state",
        {name: label(name) for name in states["state"].unique()},
        list(states["aiding"].unique()),
        cells,
        footnote,
    )


def _by_aiding(
    title: str,
    header: str,
    labels: Mapping[Any, str],
    aidings: list[str],
    cells: Mapping[tuple[Any, str], str],
    footnote: str = "",
) -> DisplayTable:
    return DisplayTable(
        title,
        (header, *(_SHORT.get(aiding, aiding) for aiding in aidings)),
        "l" + "r" * len(aidings),
        tuple((label, *(cells[key, aiding] for aiding in aidings)) for key, label in labels.items()),
        footnote,
    )


def singular_value_figure(title: str, values: pd.DataFrame, tolerance: float) -> Figure:
    """Draw the singular values of each aiding as shares of its largest, and the tolerance."""
    curves, legend = [], []
    for count, (aiding, rows) in enumerate(values.groupby("aiding", sort=False)):
        largest = rows["singular_value"].max() or 1.0
        share = np.maximum(rows["singular_value"].to_numpy() / largest, _SMALLEST)
        curves.append(Curve(rows["number"].to_numpy(np.float64), share, filter_style(count)))
        legend.append((filter_style(count), str(aiding)))
    panel = Panel(
        "singular values, share of the largest",
        "number of the singular value",
        tuple(curves),
        levels=(tolerance,),
        y_scale="log",
        x_whole=True,
    )
    return Figure(title, "Below the tolerance nothing is seen.", (panel,), (*legend, (LIMIT, "tolerance")))
