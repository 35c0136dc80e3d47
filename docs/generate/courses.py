"""Twenty-five figure-eights with what the paper gives of its own, next to the 18 values of tables III and IV.

The paper gives duration, mean speed, mean and largest turn rate, and the time of the first turn. These courses have all
of them, and other legs between the turns. The IMU has 20 Hz, which moves no value by as much as the limits of the page.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape

import numpy as np
import pandas as pd
import paper_tables
from paper_tables import Compared

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.states import NINE
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.trajectories import SCENARIOS, Scenario, Segment

BASES_S = (25.0, 30.0, 35.0, 40.0, 45.0)
DIAGONALS_S = (34.0, 40.0, 46.0, 52.0, 58.0)
IMU_RATE_HZ = 20.0
STATES = [state.id for state in NINE]
# Pixels of the picture.
WIDTH = 860
ROW = 22
TOP = 48
LEFT = 70
PLOT = 350
GAP = 60


@dataclass(frozen=True)
class Eight:
    """A course and what the filters give on it."""

    base_s: float
    diagonal_s: float
    compared: Compared

    @property
    def agreeing(self) -> int:
        """How many of the 18 values are those of the paper, within the limits of the page."""
        count = 0
        for state, row in self.compared.course.rows.iterrows():
            improvement = self.compared.improvement.loc[state]
            count += paper_tables.improvement_agrees(row, improvement)
            count += paper_tables.time_agrees(row, self.compared.convergence.loc[state])
        return count


def scenario(base_s: float, diagonal_s: float) -> Scenario:
    """Return the figure-eight with other legs."""
    sample = SCENARIOS["figure-eight"]
    first, right, _, _, _, left, _, _ = sample.segments
    base = Segment(base_s)
    diagonal = Segment(diagonal_s)
    segments = (first, right, base, right, diagonal, left, base, left)
    return replace(sample, segments=segments)


def replayed() -> list[Eight]:
    """Replay all courses."""
    config = load_config("levy-klein", overrides=["evaluation.starts=1"])
    found = []
    for base_s in BASES_S:
        for diagonal_s in DIAGONALS_S:
            course = scenario(base_s, diagonal_s)
            replay = replay_dive(simulate_dive(course, imu_rate_hz=IMU_RATE_HZ), config)
            compared = paper_tables.compared("figure_eight", replay)
            found.append(Eight(base_s, diagonal_s, compared))
    return found


def ranges(found: Sequence[Eight]) -> str:
    """Write how far the means go, and how many values agree."""
    improvements = [eight.compared.mean_improvement_pct for eight in found]
    sooner = [eight.compared.mean_nearest_pct for eight in found]
    agreeing = [eight.agreeing for eight in found]
    course = found[0].compared.course
    return (
        f"- courses: {len(found)}, with legs of {BASES_S[0]:.0f} to {BASES_S[-1]:.0f} s and {DIAGONALS_S[0]:.0f} to "
        f"{DIAGONALS_S[-1]:.0f} s between the turns\n"
        f"- mean improvement: {min(improvements):.1f} % to {max(improvements):.1f} %, the paper has "
        f"{course.mean_improvement_pct:.1f} %\n"
        f"- mean convergence: {min(sooner):.0f} % to {max(sooner):.0f} % sooner, the paper has "
        f"{course.mean_convergence_pct:.0f} %\n"
        f"- of the 18 values, {min(agreeing)} to {max(agreeing)} agree within the limits above"
    )


def picture(found: Sequence[Eight], sample: Compared) -> bytes:
    """Draw the 18 values: grey dots for the courses, blue for the sample log, a red line for the paper."""
    height = TOP + ROW * len(STATES) + 58
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
        'font-size="13">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    everything = [eight.compared for eight in found]
    left = LEFT
    for title, name in (
        ("sigma smaller, %", "improvement"),
        ("convergence sooner, %", "convergence"),
    ):
        lines.append(f'<text x="{left}" y="{TOP - 22}">{escape(title)}</text>')
        for tick in (0, 25, 50, 75, 100):
            x = left + PLOT * tick / 100.0
            bottom = TOP + ROW * len(STATES)
            lines.append(
                f'<line x1="{x}" x2="{x}" y1="{TOP - 10}" y2="{bottom}" stroke="#e5e7eb"/>'
            )
            lines.append(
                f'<text x="{x}" y="{bottom + 16}" text-anchor="middle" fill="#4b5563">{tick}</text>'
            )
        for number, state in enumerate(STATES):
            y = TOP + ROW * number + ROW // 2
            lines.append(f'<text x="{left - 8}" y="{y + 4}" text-anchor="end">{state}</text>')
            for compared in everything:
                lines.append(_dot(left, y, value_of(compared, name, state), "#9ca3af", 3))
            lines.append(_dot(left, y, value_of(sample, name, state), "#1f4e9c", 4))
            lines.append(_mark(left, y, published_value(sample, name, state)))
        left += PLOT + GAP
    lines.append(
        f'<text x="{LEFT}" y="{height - 12}" fill="#4b5563">grey: {len(found)} courses; blue: the sample log; red: the '
        "paper. No red line: the paper prints none</text>"
    )
    return "\n".join([*filter(None, lines), "</svg>", ""]).encode()


def value_of(compared: Compared, name: str, state: str) -> float:
    """Return a value of ours, %."""
    table: pd.DataFrame = getattr(compared, name)
    column = "improvement_pct" if name == "improvement" else "nearest_approach_improvement_pct"
    return float(table.loc[state, column])


def published_value(compared: Compared, name: str, state: str) -> float:
    """Return a value of the paper, %; NaN where it prints none."""
    column = "improvement_pct" if name == "improvement" else "convergence_improvement_pct"
    return float(compared.course.rows.loc[state, column])


def _dot(left: float, y: float, value_pct: float, colour: str, radius: int) -> str:
    if not np.isfinite(value_pct):
        return ""
    x = left + PLOT * np.clip(value_pct, 0.0, 100.0) / 100.0
    return f'<circle cx="{x:.1f}" cy="{y}" r="{radius}" fill="{colour}" fill-opacity="0.7"/>'


def _mark(left: float, y: float, value_pct: float) -> str:
    if not np.isfinite(value_pct):
        return ""
    x = left + PLOT * value_pct / 100.0
    return f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y - 8}" y2="{y + 8}" stroke="#b42318" stroke-width="2"/>'
