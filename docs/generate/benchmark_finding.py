"""What the public benchmark finds of the paper's method, in sentences whose numbers are those of the results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from benchmark_cells import WORDS, Cell
from benchmark_page import ONE_DIVE, usual_quantity, with_evidence, word_of

from insdvl_replay.core.config import Acceleration, Config
from insdvl_replay.core.quantities import label
from insdvl_replay.core.tables import finite, share_text
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import GOOD, NO_EFFECT
from insdvl_replay.evaluation.sentences import ratio_with_interval
from insdvl_replay.geometry.frames import beam_vectors, whole_ping_cov
from insdvl_replay.nav.dvl import slope_windows

PUBLISHED: Final = "published"
FITTED: Final = "windowed_fitted"
EQUAL: Final = (Verdict.EQUIVALENT, Verdict.EQUIVALENT_WITHOUT_DVL)
NUMBERS: Final = {
    1: "one",
    2: "two",
    3: "three",
    4: "four",
    5: "five",
    6: "six",
    7: "seven",
    8: "eight",
}


def cell_of(cells: Sequence[Cell], candidate: str) -> Cell | None:
    """Return the cell of a candidate, if it has evidence."""
    for cell in cells:
        if cell.candidate == candidate and cell.has_evidence:
            return cell
    return None


def dives_of(name: str, count: int) -> str:
    """Write how many dives of which vehicle there are, such as ``four dives of a Blueye X3``."""
    noun = "dive" if count == 1 else "dives"
    number = NUMBERS.get(count, str(count))
    return f"{number} {WORDS['dives'].get(name, f'{{}} of {name}').format(noun)}"


@dataclass(frozen=True)
class Moved:
    """How far a candidate moves an error on the dives that measure it."""

    moves: list[float]  # root mean square, in the unit of the quantity
    shares: list[float]  # of the baseline's error


def moved_on_dives(cell: Cell, quantity: str) -> Moved:
    """Return how far a candidate moves an error on each dive that has this row."""
    moved = Moved([], [])
    for report in cell.reports.values():
        for row in report.tables.evidence:
            is_asked = (row.filter, row.quantity) == (cell.candidate, quantity)
            if is_asked and np.isfinite(finite(row.acts)):
                moved.moves.append(finite(row.moves))
                moved.shares.append(finite(row.acts))
    return moved


def quote(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Say what the published update does, and the verdict on both forms of it: an item for each data set."""
    items = []
    for name, cells in with_evidence(sets).items():
        published = cell_of(cells, PUBLISHED)
        if published is None or published.decisive is None:
            continue
        row = published.decisive
        place = f"On {dives_of(name, row.dives)}"
        sentences = [f"- {place}, the published update is {_verdict(published)}."]
        sentences += _how_far(published)
        fitted = cell_of(cells, FITTED)
        if fitted is not None:
            sentences.append(f"With windows and fitted noise it is {_verdict(fitted)}.")
        items.append(" ".join(sentences))
    return "\n".join(items)


def _verdict(cell: Cell) -> str:
    """Write the word of a cell with its ratio, and how far the filter moves this error."""
    assert cell.decisive is not None
    word = word_of(cell)
    if word == ONE_DIVE:
        word = "undecided"
    row = cell.decisive
    return f"{word}: {ratio_with_interval(row)}, moved by {share_text(row.acts)}"


def _how_far(cell: Cell) -> list[str]:
    """Say how far a candidate moves the track, and why that is more than no effect, where an outage decides."""
    assert cell.decisive is not None
    row = cell.decisive
    if row.evidence != "outage":
        return []
    on_track = moved_on_dives(cell, "position")
    said = []
    if on_track.shares:
        usual_m = float(np.median(on_track.moves))
        usual_share = float(np.median(on_track.shares))
        said.append(
            f"It moves the track by {1e3 * usual_m:.1f} mm in the median ({share_text(usual_share)} "
            f"of its error) and by {1e3 * max(on_track.moves):.1f} mm "
            f"({share_text(max(on_track.shares))}) at most."
        )
    if cell.answer is None or cell.answer.verdict not in EQUAL:
        return said
    if finite(row.acts_most) >= NO_EFFECT:
        said.append(
            f"It moves the drift by {share_text(row.acts)} in the median and by "
            f"{share_text(row.acts_most)} on one dive. *No effect* takes less than "
            f"{share_text(NO_EFFECT)} of every error, so the word is *{cell.answer.verdict}*."
        )
    return said


def why(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Say why the published update does so little: its noise, and velocities that were used already."""
    for name, cells in with_evidence(sets).items():
        published = cell_of(cells, PUBLISHED)
        fitted = cell_of(cells, FITTED)
        if published is not None and fitted is not None:
            return _why_on(name, published, fitted, usual_quantity(cells))
    return ""


def _why_on(name: str, published: Cell, fitted: Cell, quantity: str) -> str:
    assert fitted.decisive is not None
    config = settings_of(published)
    update = config.filters[PUBLISHED].acceleration
    assert update is not None
    assert update.sd_mps2 is not None
    slope_sd_mps2, correlation = slope_of(config, update)
    gain = "and gains nothing that is decided"
    if fitted.answer is not None and fitted.answer.verdict in GOOD:
        gain = "and makes it smaller"
    return (
        f"The update does so little on {name} for two reasons. Its noise of {update.sd_mps2:g} "
        f"m/s2 is {update.sd_mps2 / slope_sd_mps2:.0f} times that of the slope of {update.window} "
        f"velocities at 1 Hz ({slope_sd_mps2:.2g} m/s2, by the fitted noise of the DVL). And the "
        "filter has already used these velocities: the slope has a correlation of "
        f"{correlation:.2f} with the last of them, so it adds little that is new. `{FITTED}` has "
        f"the noise of the slope. It moves the {label(quantity)} by "
        f"{share_text(fitted.decisive.acts)} {gain}."
    )


def settings_of(cell: Cell) -> Config:
    """Return the settings of the first dive of a cell."""
    report = next(iter(cell.reports.values()))
    return msgspec.convert(report.config, Config)


def slope_of(config: Config, update: Acceleration) -> tuple[float, float]:
    """Return the noise of the slope of pings at 1 Hz, m/s2, and its correlation with the last velocity."""
    assert config.dvl.beam_sd_mps is not None
    velocity_sd_mps = config.dvl.beam_sd_mps * float(whole_ping_cov(beam_vectors())[0, 0]) ** 0.5
    times_s = np.arange(float(update.window))
    weights = slope_windows(times_s, update.window).velocity_weights[-1]
    size = float(np.linalg.norm(weights))
    return velocity_sd_mps * size, float(weights[-1]) / size
