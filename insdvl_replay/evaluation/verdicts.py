"""Verdicts in words: whether a filter is as good as it says, and whether a believed improvement is one.

An improvement is borne out when the error against the reference falls by at least half of what the filter believes. A
filter is called over-confident or over-cautious when its innovations say so with significance and by a size that
matters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from insdvl_replay.evaluation.believed import mean_over_nine
from insdvl_replay.result_tables import VERDICTS_BEST_FIRST

NOTABLE_PCT: Final = 5.0
"""A smaller change, believed or real, is not spoken of as an improvement."""
BORNE_OUT: Final = 0.5
"""Share of the believed improvement that the reference has to confirm."""
COMPARED: Final = ("velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "heading", "position_h")
"""Quantities whose median change stands for the error against the reference."""
GRAVEST_FIRST: Final = (*reversed(VERDICTS_BEST_FIRST), "too few")


@dataclass(frozen=True)
class Verdict:
    """What there is to say of one candidate.

    Attributes
    ----------
    filter : str
        Its name.
    consistency : str
        The gravest of its measurements' verdicts.
    believed_pct : float
        Mean improvement over nine states.
    actual_pct : float
        Median improvement of the error against the reference; NaN without one.
    improvement : str
        ``borne out``, ``not borne out``, ``worse`` (against the reference), ``none believed`` or ``no reference``.
    sentence : str
        All of it for people.
    """

    filter: str
    consistency: str
    believed_pct: float
    actual_pct: float
    improvement: str
    sentence: str


def verdicts(tables: dict[str, pd.DataFrame], baseline: str, candidates: Sequence[str]) -> tuple[Verdict, ...]:
    """Judge each candidate.

    Parameters
    ----------
    tables : dict of str to DataFrame
        ``improvement``, ``reference_error`` and ``consistency``.
    baseline : str
        Name of the first filter.
    candidates : sequence of str
        Names of the others.

    Returns
    -------
    tuple of Verdict
    """
    return tuple(_verdict(tables, baseline, candidate) for candidate in candidates)


def consistency_of(table: pd.DataFrame, filter_name: str) -> str:
    """Give the gravest verdict among a filter's measurements.

    Parameters
    ----------
    table : DataFrame
        From `consistency.consistency_table`.
    filter_name : str

    Returns
    -------
    str
    """
    found = set(table.loc[table["filter"] == filter_name, "verdict"])
    return next((word for word in GRAVEST_FIRST if word in found), "too few")


def _verdict(tables: dict[str, pd.DataFrame], baseline: str, candidate: str) -> Verdict:
    believed_pct = mean_over_nine(tables["improvement"], candidate)
    rows = tables["reference_error"]
    rows = rows[(rows["filter"] == candidate) & (rows["status"] == "compared")].set_index("quantity")
    compared = rows.loc[rows.index.isin(COMPARED), "improvement_pct"].dropna()
    actual_pct = float(compared.median()) if len(compared) else float("nan")
    improvement = _borne_out(believed_pct, actual_pct)
    consistency, of_baseline = (consistency_of(tables["consistency"], name) for name in (candidate, baseline))
    sentence = (
        f"{candidate} {_believes(believed_pct, baseline)}; {_against_reference(rows, actual_pct)}: "
        f"{_CONCLUSION[improvement]}. {_on_consistency(consistency, of_baseline, candidate, baseline)}"
    )
    return Verdict(candidate, consistency, believed_pct, actual_pct, improvement, sentence)


def _borne_out(believed_pct: float, actual_pct: float) -> str:
    if not np.isfinite(actual_pct):
        return "no reference"
    if actual_pct < -NOTABLE_PCT:
        return "worse"
    if not believed_pct >= NOTABLE_PCT:
        return "none believed"
    return "borne out" if actual_pct >= BORNE_OUT * believed_pct else "not borne out"


_CONCLUSION: Final = {
    "borne out": "the improvement is borne out",
    "not borne out": "the improvement is NOT borne out",
    "worse": "it is WORSE",
    "none believed": "no improvement",
    "no reference": "nothing tells whether that is so",
}


def _believes(believed_pct: float, baseline: str) -> str:
    if not np.isfinite(believed_pct):
        return "believes in nothing finite"
    if abs(believed_pct) < NOTABLE_PCT:
        return f"believes in errors as large as those of {baseline} ({believed_pct:+.1f} %)"
    return f"believes in {abs(believed_pct):.1f} % {'smaller' if believed_pct > 0 else 'larger'} errors than {baseline}"


def _against_reference(rows: pd.DataFrame, actual_pct: float) -> str:
    if not np.isfinite(actual_pct):
        return "there is no reference to compare with"
    size = "smaller" if actual_pct >= 0 else "larger"
    change = f"the errors against the reference are {abs(actual_pct):.1f} % {size} in the median"
    if "position_h" not in rows.index:
        return change
    position = rows.loc["position_h"]
    return f"{change} (position {position['baseline_rmse']:.2f} m, now {position['rmse']:.2f} m)"


def _on_consistency(consistency: str, of_baseline: str, candidate: str, baseline: str) -> str:
    if consistency != of_baseline:
        return f"{candidate} is {consistency}, {baseline} {of_baseline}."
    return "Too few updates to judge either." if consistency == "too few" else f"Both filters are {consistency}."
