"""How many dives it takes: what the dives of a result can find in each quantity, and how many find smaller changes."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Final

from msgspec import Struct

from insdvl_replay.core.errors import ConfigError, counted
from insdvl_replay.core.quantities import FEWEST_DIVES
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import Col, Number, PooledRow, finite
from insdvl_replay.core.words import Role
from insdvl_replay.document.parts import (
    Block,
    Part,
    Result,
    Title,
)
from insdvl_replay.document.tables import shown
from insdvl_replay.evaluation.answers import CandidateAnswer
from insdvl_replay.evaluation.interval import (
    BAND,
    chance_found,
    change_found,
    dives_needed,
    smallest_sign_p,
)
from insdvl_replay.evaluation.sentences import SCATTER_OF_ACTS
from insdvl_replay.show.answers import answers_of

SOUGHT_PCT: Final = (20.0, 10.0, 7.0)  # Changes for which a number of dives is given.
# What a plan is asked for both of, or for none of: the error and its hint.
EITHER: Final = ("plan takes either RESULTS or --tracks", "insdvl-replay plan --tracks 5")
# Scatters for which a plan without results is made: from dives that hardly differ to those of public data sets.
USUAL_SCATTERS: Final = (0.05, 0.1, 0.2, 0.5)


class PlanRow(Struct, frozen=True):
    """One quantity of a candidate: the change that these dives find, and the dives that find smaller ones."""

    title: ClassVar = "Dives that find a change in four of five cases"
    footnote: ClassVar = (
        "finds: the change that these dives find. 20 %, 10 %, 7 %: the number of dives that find so much; empty: more "
        "than a thousand. Scatter: standard deviation of the logarithm of the ratio over dives; of fewer than three "
        "dives it is taken as 0.6 of how far the candidate acts."
    )

    filter: Annotated[str, Col("Candidate and quantity.", head="filter")]
    quantity: Annotated[str, Col(head="quantity", form="label")]
    role: Annotated[str, Col("primary (it decides), secondary, or shown.", head="role")]
    dives: Annotated[int, Col("Dives with a ratio.", head="dives")]
    scatter: Annotated[
        Number, Col("Standard deviation of the logarithm of the ratio.", head="scatter", form="3")
    ]
    finds_pct: Annotated[
        Number, Col("Change that so many dives find.", head="finds\n[%]", form="0")
    ]
    dives_20pct: Annotated[
        int | None, Col("Dives that find a change of so many percent.", head="20 %")
    ]
    dives_10pct: Annotated[int | None, Col(head="10 %")]
    dives_7pct: Annotated[int | None, Col(head="7 %")]


class TracksRow(Struct, frozen=True):
    """What some number of dives can find, if the ratio scatters so much from dive to dive."""

    title: ClassVar = "What so many dives can find"
    footnote: ClassVar = (
        "scatter: standard deviation of the logarithm of the ratio over dives. finds: the change that so many dives "
        "find in four of five cases; empty: fewer than three dives have no verdict. chance: how often they find the "
        "ratio. needed: the number of dives that find it in four of five cases; empty: more than a thousand."
    )

    dives: Annotated[int, Col("Dives, or tracks.", head="dives")]
    scatter: Annotated[
        float, Col("Standard deviation of the logarithm of the ratio.", head="scatter", form="2")
    ]
    finds_pct: Annotated[
        Number,
        Col("Change that so many dives find in four of five cases.", head="finds\n[%]", form="0"),
    ]
    ratio: Annotated[float, Col("The ratio that is looked for.", head="ratio", form="2")]
    chance_pct: Annotated[
        float, Col("How often so many dives find it.", head="chance\n[%]", form="0")
    ]
    needed: Annotated[int | None, Col("Dives that find it in four of five cases.", head="needed")]


def tracks_rows(dives: int, ratio: float) -> Iterator[TracksRow]:
    """Yield what so many dives can find, for each usual scatter.

    Raises
    ------
    ConfigError
        No number of dives can find the ratio, which is in the band.
    """
    most = 1.0 / BAND
    if not 0.0 < ratio < most:
        raise ConfigError(
            f"a ratio of {ratio:g} cannot be found", f"choose one above 0 and below {most:.3f}"
        )
    for scatter in USUAL_SCATTERS:
        found = change_found(scatter, dives)
        yield TracksRow(
            dives,
            scatter,
            _or_missing(100.0 * (1.0 - found)),
            ratio,
            100.0 * chance_found(scatter, dives, ratio),
            dives_needed(scatter, ratio),
        )


def plan_of_tracks(dives: int, ratio: float) -> Result:
    """Return what so many dives can find, before any is replayed."""
    rows = list(tracks_rows(dives, ratio))
    count = counted(dives, "dive")
    title = f"What {count} can find"
    sign = f"The smallest two-sided p of a sign test of {count} is {smallest_sign_p(dives):.3g}."
    return Result(
        kind="plan",
        title=title,
        tables={"plan": Block.of(TracksRow, rows)},
        block="",
        document=[Title(title), sign, shown(TracksRow, rows)],
    )


def plan_rows(answers: Sequence[CandidateAnswer]) -> Iterator[PlanRow]:
    """Yield a row for each candidate and each quantity whose scatter is known or can be guessed."""
    for answer in answers:
        for row in answer.known:
            if row.role in (Role.PRIMARY, Role.SECONDARY) and not _is_by_vehicle(row):
                yield _plan_row(row)


def _is_by_vehicle(row: PooledRow) -> bool:
    """Return whether vehicles are the samples, so that no number of dives can be given."""
    return row.dives >= FEWEST_DIVES and math.isnan(finite(row.scatter))


def _plan_row(row: PooledRow) -> PlanRow:
    level = finite(row.level_pct) / 100.0
    is_known = row.dives >= FEWEST_DIVES
    scatter = finite(row.scatter) if is_known else SCATTER_OF_ACTS * finite(row.acts)
    found = change_found(scatter, row.dives, level)
    needed = [dives_needed(scatter, 1.0 - sought_pct / 100.0, level) for sought_pct in SOUGHT_PCT]
    return PlanRow(
        row.filter,
        row.quantity,
        row.role,
        row.dives,
        _or_missing(scatter),
        _or_missing(100.0 * (1.0 - found)),
        *needed,
    )


def _or_missing(value: float) -> Number:
    if math.isnan(value):
        return None
    return value


def _nothing_to_plan(reports: Sequence[Report]) -> str:
    for answer in answers_of(reports):
        if any(_is_by_vehicle(row) for row in answer.known):
            return "Each vehicle is one sample: no number of dives replaces more vehicles."
    return "There is no evidence to plan with."


def plan_result(reports: Sequence[Report]) -> Result:
    """Return the plan of a result's dives."""
    rows = list(plan_rows(answers_of(reports)))
    find = "finds" if len(reports) == 1 else "find"
    title = f"What {counted(len(reports), 'dive')} {find}"
    parts: list[Part] = [Title(title)]
    if rows:
        parts.append(shown(PlanRow, rows))
    else:
        parts.append(_nothing_to_plan(reports))
    return Result(
        kind="plan",
        title=title,
        tables={"plan": Block.of(PlanRow, rows)},
        block="",
        document=parts,
    )
