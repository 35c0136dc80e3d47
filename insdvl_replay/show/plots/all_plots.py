"""All plots of a dive, by what draws them: those of its page in their order, those for a paper by name."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.core.report import Row
from insdvl_replay.core.states import STATES
from insdvl_replay.document.parts import Figure, Panel, Shade
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.evaluation.consistency import mean_interval
from insdvl_replay.preparation.replay import Replay
from insdvl_replay.results.trajectory import Trajectory
from insdvl_replay.show.plots.curves import StoredDive
from insdvl_replay.show.plots.errors import (
    errors_figure,
    errors_for_paper,
    nis_figure,
    nis_for_paper,
    sigma_figure,
    sigma_for_paper,
)
from insdvl_replay.show.plots.evidence import (
    convergence_figure,
    convergence_for_paper,
    drift_panel,
    outage_figure,
    outage_for_paper,
    position_error_panel,
)
from insdvl_replay.show.plots.motion import (
    acceleration_figure,
    error_vectors_panel,
    motion_figure,
    track_for_paper,
    track_panel,
)
from insdvl_replay.show.plots.shades import shades_of

if TYPE_CHECKING:
    import pandas as pd


def on_page(replay: Replay, clock: Clock) -> Iterator[Figure]:
    """Yield the figures of a page: measured errors, then predicted errors, then the motion."""
    yield from errors_figure(replay, clock)
    yield from outage_figure(replay.curves.outage, clock)
    yield from convergence_figure(replay.curves.convergence, replay.tables.evidence)
    yield sigma_figure(replay.histories, clock)
    yield nis_figure(replay.histories, clock, lambda dof: mean_interval(dof, 1))
    yield motion_figure(replay, clock)
    yield from acceleration_figure(replay, clock)


FOR_PAPER: Final[Mapping[str, Callable[[StoredDive], Figure]]] = {
    "error": errors_for_paper,
    "track": track_for_paper,
    "sigma": sigma_for_paper,
    "nis": nis_for_paper,
    "outage": outage_for_paper,
    "convergence": convergence_for_paper,
}
WITH_STATES: Final = "sigma"  # the only plot whose states are chosen
WITH_REFERENCE: Final = "track"  # the only one that shows the reference


# --- On a page.


def replay_figures(replay: Replay) -> tuple[Figure, ...]:
    """Draw all figures of a replay; panels over its time have the same axis, and shades behind them."""
    clock = Clock(replay.start_ns, replay.end_ns)
    figures = list(on_page(replay, clock))
    shades = shades_of(replay)
    drawn = []
    for figure in figures:
        panels = tuple(_over_time(panel, shades, clock) for panel in figure.panels)
        drawn.append(replace(figure, panels=panels))
    return tuple(drawn)


def first_panels(replay: Replay) -> list[Panel]:
    """Draw the horizontal error over time, or the drift without DVL; the track; and, folded, its error vectors."""
    return [*error_panel(replay), track_panel(replay), *error_vectors_panel(replay)]


def error_panel(replay: Replay) -> Iterator[Panel]:
    """Draw the horizontal error over time; without a reference the drift without DVL, if it is known."""
    clock = Clock(replay.start_ns, replay.end_ns)
    if replay.curves.position:
        panel = position_error_panel(replay.curves.position, replay.start_ns, clock)
        yield _over_time(panel, shades_of(replay), clock)
    elif replay.curves.outage:
        yield drift_panel(replay.curves.outage)


def _over_time(panel: Panel, shades: tuple[Shade, ...], clock: Clock) -> Panel:
    """Give a panel over time the shades, and the axis of all such panels."""
    if panel.x_label == clock.label and panel.x_scale == "linear":
        return replace(panel, shades=shades, x_limits=clock.limits)
    return panel


# --- For a paper.


def paper_figure(
    kind: str,
    trajectory: Trajectory,
    tables: Mapping[str, Sequence[Row]],
    states: tuple[str, ...],  # from `chosen_states`
    reference: "Callable[[], pd.DataFrame | None]",  # is asked only if the plot shows it
) -> Figure:
    """Return a figure of a kind, by the tables of the dive."""
    kinds = tuple(FOR_PAPER)
    require_known("figure", kind, kinds, most=len(kinds))
    shown_reference = None
    if kind == WITH_REFERENCE:
        shown_reference = reference()
    dive = StoredDive(trajectory, tables, states, shown_reference)
    figure = FOR_PAPER[kind](dive)
    if not figure.panels:
        raise ConfigError(f"there is nothing to draw for {kind}", f"kinds: {', '.join(kinds)}")
    return figure


def chosen_states(kind: str, text: str, option: str) -> tuple[str, ...]:
    """Read names of states, or their beginnings such as ``ba``, with commas between them; a plot without them has none.

    The option, with its value, is for the sentence of the ConfigError.
    """
    if text and kind != WITH_STATES:
        text = f"{option}: works with {WITH_STATES} only, not with {kind}"
        raise ConfigError(text, "leave it out")
    names = tuple(part.strip() for part in text.split(",") if part.strip())
    known = [state.id for state in STATES]
    beginnings = list(dict.fromkeys(name.partition("_")[0] for name in known))
    for name in names:
        if not any(state.startswith(name) for state in known):
            require_known("state", name, [*beginnings, *known])
    return names
