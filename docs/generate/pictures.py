"""The pictures in the documents, drawn by the program. `make pictures` renews them; tests hold them equal.

Those of the Monte Carlo and window studies come with `make reproduce`, which has their numbers.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from example_lake import write_example_lake
from flow_picture import flow_picture
from verdict_picture import verdict_picture
from written import PROJECT

from insdvl_replay.core.config_file import load_config
from insdvl_replay.document.parts import Figure, Result
from insdvl_replay.document.plot import sheet_svg
from insdvl_replay.evaluation.ensemble import Ensemble
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.show.history import history_result
from insdvl_replay.show.plots.all_plots import replay_figures
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.studies.montecarlo import PICTURES as ENSEMBLE_PICTURES
from insdvl_replay.studies.montecarlo import ensemble_figure
from insdvl_replay.studies.window import window_figure

EVERY = 5
"""Of the pings in an ensemble, so many make one point of a curve."""


def sample(name: str) -> Replay:
    """Replay a sample log."""
    return replay_log(PROJECT / "sample_logs" / f"{name}.mcap", load_config("levy-klein"))


def lawnmower() -> Replay:
    """Replay legs and U-turns."""
    return replay_dive(simulate_dive("lawnmower", seed=1), load_config("levy-klein"))


def titled(replay: Replay, title: str) -> Figure:
    """Return the figure of a replay with a title."""
    return next(figure for figure in replay_figures(replay) if figure.title == title)


def sigmas(replay: Replay) -> bytes:
    """Draw the standard deviations of the nine states without the velocity errors, as the paper shows them."""
    figure = titled(replay, "Predicted standard deviations")
    return sheet_svg(replace(figure, panels=figure.panels[3:]))


def track(replay: Replay) -> bytes:
    """Draw the way from above, and the turn rate."""
    motion = titled(replay, "Motion of the vehicle")
    return sheet_svg(replace(motion, panels=(motion.panels[0], motion.panels[2])))


def history() -> bytes:
    """Draw the ratios over the versions in the lake of the page on it."""
    with TemporaryDirectory() as name:
        lake = Path(name) / "lake"
        write_example_lake(lake)
        return sheet_svg(history_result(lake).figures["history"])


PICTURES: dict[str, Callable[[], bytes]] = {
    "docs/history.svg": history,
    "docs/straight_sigma.svg": lambda: sigmas(sample("straight")),
    "docs/figure_eight_sigma.svg": lambda: sigmas(sample("figure_eight")),
    "docs/figure_eight_track.svg": lambda: track(sample("figure_eight")),
    "docs/lawnmower_track.svg": lambda: track(lawnmower()),
    "docs/verdict.svg": verdict_picture,
    "docs/flow.svg": flow_picture,
}


def ensemble_pictures(ensemble: Ensemble, title: str) -> dict[str, Callable[[], bytes]]:
    """Name the pictures of the Monte Carlo study, as `PICTURES` does those of the samples.

    Parameters
    ----------
    ensemble : Ensemble
        Of the aided filter, over the lawnmower.
    title : str
    """
    columns = (ensemble.time_s, ensemble.sd, ensemble.error_sd, ensemble.error_mean)
    thinned = [column[::EVERY] for column in columns]
    drawn = {
        f"docs/lawnmower_{name}.svg": partial(ensemble_figure, title, states, *thinned)
        for name, states in ENSEMBLE_PICTURES.items()
    }
    return {name: partial(lambda draw: sheet_svg(draw()), draw) for name, draw in drawn.items()}


def window_picture(window: Result) -> dict[str, Callable[[], bytes]]:
    """Name the picture of the window study."""
    return {"docs/window.svg": lambda: sheet_svg(window_figure(window.tables["window"]))}


def write(pictures: dict[str, Callable[[], bytes]]) -> None:
    """Draw pictures where their names say."""
    for name, draw in pictures.items():
        (PROJECT / name).parent.mkdir(exist_ok=True)
        (PROJECT / name).write_bytes(draw())


if __name__ == "__main__":
    write(PICTURES)
