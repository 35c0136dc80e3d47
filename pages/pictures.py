"""The pictures in the documents, drawn by the program. `make pictures` renews them; a test holds them equal."""

from dataclasses import replace
from pathlib import Path

from insdvl_replay.config_file import load_config
from insdvl_replay.replay import replay_log
from insdvl_replay.report.figures.clock import Clock
from insdvl_replay.report.figures.sigma import sigma_figure
from insdvl_replay.report.plots.sheet import sheet_svg

PROJECT = Path(__file__).resolve().parents[1]
PICTURES = {f"docs/{name}_sigma.svg": PROJECT / "sample_logs" / f"{name}.mcap" for name in ("straight", "figure_eight")}


def drawn(log: Path) -> bytes:
    """The standard deviations of the nine states without the velocity errors, as the paper shows them."""
    replay = replay_log(log, load_config())
    figure = sigma_figure(replay.histories, Clock(replay.start_ns, replay.end_ns))
    return sheet_svg(replace(figure, panels=figure.panels[3:]))


if __name__ == "__main__":
    for name, log in PICTURES.items():
        (PROJECT / name).parent.mkdir(exist_ok=True)
        (PROJECT / name).write_bytes(drawn(log))
