"""The numbers that Levy and Klein print, and the tables that show them next to ours."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import claims
import numpy as np
import pandas as pd
from written import markdown_table

from insdvl_replay.core.tables import finite
from insdvl_replay.preparation.replay import Replay

FACTS = Path(__file__).with_name("levy_klein.toml")
SD_WITHIN = 0.05
"""Standard deviations agree within this share."""
REACHED_WITHIN_S = 8.0
"""Convergence times agree within this."""
MEAN_WITHIN_PCT = 3.0
"""Mean improvements agree within this many percent."""
IMPROVEMENT_WITHIN_PCT = 2.0
"""Improvements of single states agree within this many percent."""
NOT_REACHED = "-"


@dataclass(frozen=True)
class Course:
    """What the paper prints of one course."""

    errors_table: str  # number of the table
    times_table: str
    duration_s: float
    mean_improvement_pct: float
    mean_convergence_pct: float
    rows: pd.DataFrame  # of both tables, by state


@dataclass(frozen=True)
class Compared:
    """Rows of ours next to rows of the paper, both by state."""

    course: Course
    improvement: pd.DataFrame
    convergence: pd.DataFrame
    mean_improvement_pct: float
    mean_nearest_pct: float
    mean_crossing_pct: float


def read_course(name: str) -> Course:
    """Read what the paper prints of ``straight`` or ``figure_eight``."""
    facts = read_facts()[name]
    rows = pd.read_csv(FACTS.with_name(facts.pop("rows"))).set_index("state")
    return Course(**facts, rows=rows)


def read_facts() -> dict[str, Any]:
    """Read the file of facts."""
    return tomllib.loads(FACTS.read_text("utf-8"))


def compared(name: str, replay: Replay) -> Compared:
    """Put a replay of a sample log next to the paper."""
    return Compared(
        read_course(name),
        claims.by_state(claims.frame(replay.tables.improvement), "aided"),
        claims.by_state(claims.frame(replay.tables.convergence), "aided"),
        claims.mean_over(replay, "improvement"),
        finite(replay.verdicts["aided"].mean_nearest_approach_improvement_pct),
        claims.mean_over(replay, "convergence"),
    )


# --- Standard deviations, tables I and III.


def sigmas(found: Compared) -> str:
    """Write the sigmas at the end, the paper's next to ours."""
    course = found.course
    header = (
        "state",
        "unit",
        "baseline: paper",
        "here",
        "",
        "aided: paper",
        "here",
        "",
        "improvement: paper",
        "here",
        "",
    )
    rows = [
        _sigma_row(row, found.improvement.loc[str(state)]) for state, row in course.rows.iterrows()
    ]
    there = course.mean_improvement_pct
    here = found.mean_improvement_pct
    rows.append(("**mean**", *[""] * 7, percent(there), percent(here), agrees(there, here)))
    return markdown_table(header, rows)


def _sigma_row(published: pd.Series, ours: pd.Series) -> tuple[str, ...]:
    improvement_there = published["improvement_pct"]
    improvement_here = ours["improvement_pct"]
    return (
        str(published.name),
        str(published["unit"]),
        f"{published['baseline_sd']:.2f}",
        f"{ours['baseline_sd']:.2f}",
        deviation(ours["baseline_sd"], published["baseline_sd"]),
        f"{published['aided_sd']:.2f}",
        f"{ours['sd']:.2f}",
        deviation(ours["sd"], published["aided_sd"]),
        percent(improvement_there),
        percent(improvement_here),
        points(improvement_here, improvement_there),
    )


# --- Times, tables II and IV.


def times(found: Compared) -> str:
    """Write the times of the nearest approach to the baseline's last sigma, and of the crossing."""
    course = found.course
    header = (
        "state", "paper [s]", "nearest approach [s]", "agrees", "sooner: paper", "here", "crossing [s]", "sooner"
    )  # fmt: skip
    rows = [
        _time_row(row, found.convergence.loc[str(state)]) for state, row in course.rows.iterrows()
    ]
    there = course.mean_convergence_pct
    here = found.mean_nearest_pct
    means = percent(there), percent(here), "", percent(found.mean_crossing_pct)
    rows.append(("**mean**", "", "", agrees(there, here), *means))
    return markdown_table(header, rows)


def _time_row(published: pd.Series, ours: pd.Series) -> tuple[str, ...]:
    there_s = published["reached_s"]
    nearest_s = ours["nearest_approach_s"]
    is_reached = ours["status"] == "reached"
    return (
        str(published.name),
        NOT_REACHED if np.isnan(there_s) else f"{there_s:.0f}",
        f"{nearest_s:.0f}",
        "yes" if time_agrees(published, ours) else "**no**",
        percent(published["convergence_improvement_pct"]),
        percent(ours["nearest_approach_improvement_pct"]),
        f"{ours['reached_s']:.0f}" if is_reached else str(ours["status"]).replace("_", " "),
        percent(ours["improvement_pct"]),
    )


def time_agrees(published: pd.Series, ours: pd.Series) -> bool:
    """Return whether a time is the paper's, which prints none where its improvement is none: that is the end."""
    there_s = published["reached_s"]
    expected_s = ours["baseline_s"] if np.isnan(there_s) else there_s
    return bool(abs(ours["nearest_approach_s"] - expected_s) <= REACHED_WITHIN_S)


# --- All four tables together.


def headline(straight: Compared, eight: Compared) -> str:
    """Write the four means, and what each rests on."""
    settings = "settings that were fitted to table {} of the straight line"
    rests_on = (
        (straight, "errors", settings.format("I") + " itself"),
        (
            straight,
            "times",
            settings.format("I") + ", and a definition of the time that was chosen by table II",
        ),
        (eight, "errors", settings.format("I") + ", and a course that was chosen by this number"),
        (
            eight,
            "times",
            settings.format("I")
            + ", a definition chosen by table II, and a course chosen by this number",
        ),
    )
    rows = []
    for found, kind, words in rests_on:
        is_errors = kind == "errors"
        course = found.course
        there = course.mean_improvement_pct if is_errors else course.mean_convergence_pct
        here = found.mean_improvement_pct if is_errors else found.mean_nearest_pct
        table = course.errors_table if is_errors else course.times_table
        what = "smaller sigma" if is_errors else "faster convergence"
        rows.append((table, what, f"{there:.2f} %", percent(here), agrees(there, here), words))
    return markdown_table(("table", "mean", "paper", "here", "agrees", "rests on"), rows)


def tally(straight: Compared, eight: Compared) -> str:
    """Write how many rows of each table agree."""
    rows = []
    for found, is_fitted in ((straight, "fitted"), (eight, "not fitted")):
        course = found.course
        states = course.rows.index
        pairs = [(course.rows.loc[state], found.improvement.loc[state]) for state in states]
        baselines = sum(_is_near(ours["baseline_sd"], row["baseline_sd"]) for row, ours in pairs)
        aided = sum(_is_near(ours["sd"], row["aided_sd"]) for row, ours in pairs)
        improved = sum(improvement_agrees(row, ours) for row, ours in pairs)
        n = len(states)
        rows.append(
            (
                course.errors_table,
                is_fitted,
                f"sigma of the baseline {baselines} of {n}, of the aided filter {aided} of {n}, "
                f"improvement {improved} of {n}",
            )
        )
        sooner = sum(
            time_agrees(course.rows.loc[state], found.convergence.loc[state]) for state in states
        )
        fitted = "definition chosen" if is_fitted == "fitted" else "not fitted"
        rows.append((course.times_table, fitted, f"time {sooner} of {n}"))
    return markdown_table(("table", "rows are", "rows that agree"), rows)


def _is_near(here: float, there: float) -> bool:
    return bool(abs(here / there - 1.0) <= SD_WITHIN)


def improvement_agrees(published: pd.Series, ours: pd.Series) -> bool:
    """Return whether an improvement is the paper's, which prints none where there is none."""
    there = published["improvement_pct"]
    return bool(
        abs(ours["improvement_pct"] - (0.0 if np.isnan(there) else there))
        <= IMPROVEMENT_WITHIN_PCT
    )


def contradictions(straight: Compared, eight: Compared) -> str:
    """Write where the paper's text and its tables, or two of them, say different things, and what is found here."""
    return markdown_table(
        ("the paper says", "it also says", "here"), list(_contradictions(straight, eight))
    )


def _contradictions(straight: Compared, eight: Compared) -> Iterator[tuple[str, str, str]]:
    text = read_facts()["text"]
    eights = eight.course.rows
    lines = straight.course.rows
    accel = ("ba_x", "ba_y", "ba_z")
    low, high = text["accel_bias_pct"]
    yield (
        f"figure-eight: {low:.0f} to {high:.0f} % smaller sigma of the accelerometer biases on all axes",
        "table III: "
        + ", ".join(f"{eights.loc[state, 'improvement_pct']:.2f} % {state}" for state in accel),
        ", ".join(percent(eight.improvement.loc[state, "improvement_pct"]) for state in accel),
    )
    yield (
        f"conclusion: on average {text['conclusion_pct']:.0f} %, on all error states of the straight line",
        f"section on it: about {text['section_pct']:.0f} %; table I: {straight.course.mean_improvement_pct} %, and "
        "none for phi_d and bg_z",
        f"{percent(straight.mean_improvement_pct)}; phi_d and bg_z "
        + " and ".join(
            percent(straight.improvement.loc[state, "improvement_pct"])
            for state in ("phi_d", "bg_z")
        ),
    )
    yield (
        f"table I: bg_z of both filters is {lines.loc['bg_z', 'aided_sd']:.2f} deg/h, so there is no improvement",
        f"table II: the aided filter reaches this value after {lines.loc['bg_z', 'reached_s']:.0f} s, "
        f"{lines.loc['bg_z', 'convergence_improvement_pct']:.2f} % sooner",
        f"{straight.convergence.loc['bg_z', 'nearest_approach_s']:.0f} s, between two flat lines",
    )
    yield (
        "figure-eight: the z gyro bias stays unobservable",
        f"table IV: it converges in {eights.loc['bg_z', 'reached_s']:.0f} s, which counts with "
        f"{eights.loc['bg_z', 'convergence_improvement_pct']:.2f} % in the mean",
        f"{eight.convergence.loc['bg_z', 'nearest_approach_s']:.0f} s; its sigma is "
        f"{percent(eight.improvement.loc['bg_z', 'improvement_pct'])} smaller at the end",
    )
    slowest_s = eights["reached_s"].max()
    ours_s = eight.convergence.loc[
        eights.index[eights["reached_s"].notna()], "nearest_approach_s"
    ].max()
    yield (
        f"figure-eight: the overall performance of {eight.course.duration_s:.0f} s in {text['overall_s']:.0f} s",
        f"table IV: {slowest_s:.0f} s is the slowest of the eight states with a time; the "
        "aided sigma of phi_d is below the target from the start",
        f"{ours_s:.0f} s, of the same eight states",
    )
    yield (
        "conclusion: by the observability analysis, accelerations do not improve the overall accuracy",
        "section III: the accuracy is expected to improve; conclusion: it does",
        "neither follows from observability: [what the paper does not ask](#what-the-paper-does-not-ask)",
    )


# --- Words.


def percent(value: float) -> str:
    """Write a percentage, or a dash."""
    return "-" if np.isnan(value) else f"{value:.1f} %"


def deviation(here: float, there: float) -> str:
    """Write how far ours is from the paper's, in bold where that is too far."""
    share = here / there - 1.0
    text = f"{100.0 * share:+.1f} %"
    return text if abs(share) <= SD_WITHIN else f"**{text}**"


def points(here: float, there: float) -> str:
    """Write how far an improvement is from the paper's, in bold where that is too far; none counts as 0."""
    difference = here - (0.0 if np.isnan(there) else there)
    text = f"{difference:+.1f}"
    return text if abs(difference) <= IMPROVEMENT_WITHIN_PCT else f"**{text}**"


def agrees(there: float, here: float) -> str:
    """Say whether two means agree."""
    return "yes" if abs(here - there) <= MEAN_WITHIN_PCT else "**no**"
