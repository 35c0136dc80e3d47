"""Verdicts in words: whether a filter is as good as it says, and whether a believed improvement is one.

An improvement is borne out when the error against the reference falls by at least half of what the filter believes. A
filter is called over-confident or over-cautious when its innovations, or its errors against the reference, say so with
significance and by a size that matters. Where the two disagree, the sentence names both. Of a filter that is dead, or
is held against one that is, nothing is said of gain or loss.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from insdvl_replay.core.result_tables import JOINT, NOT_JUDGED, PARTLY_COVERED, VERDICTS_BEST_FIRST, is_whole
from insdvl_replay.evaluation.believed import mean_over_nine

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
        The gravest of its measurements' verdicts, each as a whole.
    credibility : str
        The verdict of its errors against the reference; ``no reference`` and the like where there is none.
    believed_pct : float
        Mean improvement over nine states.
    actual_pct : float
        Median improvement of the error against the reference; NaN without one.
    improvement : str
        ``borne out``, ``not borne out``, ``worse`` (against the reference), ``none believed``, ``no reference``, or
        ``not judged`` where one of the two filters is dead.
    sentence : str
        All of it for people.
    """

    filter: str
    consistency: str
    credibility: str
    believed_pct: float
    actual_pct: float
    improvement: str
    sentence: str


def verdicts(
    tables: dict[str, pd.DataFrame], baseline: str, candidates: Sequence[str], dead: Mapping[str, str]
) -> tuple[Verdict, ...]:
    """Judge each candidate.

    Parameters
    ----------
    tables : dict of str to DataFrame
        ``improvement``, ``reference_error``, ``consistency`` and ``credibility``.
    baseline : str
        Name of the first filter.
    candidates : sequence of str
        Names of the others.
    dead : mapping of str to str
        What is wrong with filters that cannot be judged, from `dead_filters.dead_filters`.

    Returns
    -------
    tuple of Verdict
    """
    return tuple(_verdict(tables, baseline, candidate, dead) for candidate in candidates)


def consistency_of(table: pd.DataFrame, filter_name: str) -> str:
    """Give the gravest verdict among a filter's measurements.

    Their axes say where and do not count: of eight tests one fails by chance in every third honest filter.

    Parameters
    ----------
    table : DataFrame
        From `consistency.consistency_table`.
    filter_name : str

    Returns
    -------
    str
    """
    whole = table["measurement"].map(is_whole)
    return _gravest(table.loc[(table["filter"] == filter_name) & whole, "verdict"]) or "too few"


def credibility_of(table: pd.DataFrame, filter_name: str) -> str:
    """Give the verdict of a filter's errors against the reference.

    Parameters
    ----------
    table : DataFrame
        From `credibility.credibility_table`.
    filter_name : str

    Returns
    -------
    str
        Of all states together.
    """
    rows = table[table["filter"] == filter_name].set_index("quantity")["verdict"]
    return str(rows[JOINT])


def _gravest(found: "pd.Series[str]") -> str | None:
    return next((word for word in GRAVEST_FIRST if word in set(found)), None)


def _verdict(tables: dict[str, pd.DataFrame], baseline: str, candidate: str, dead: Mapping[str, str]) -> Verdict:
    believed_pct = mean_over_nine(tables["improvement"], candidate)
    rows = tables["reference_error"]
    rows = rows[rows["filter"] == candidate].set_index("quantity")
    partly, rows = PARTLY_COVERED in set(rows["status"]), rows[rows["status"] == "compared"]
    compared = rows.loc[rows.index.isin(COMPARED), "improvement_pct"].dropna()
    actual_pct = float(compared.median()) if len(compared) else float("nan")
    wrong = list(dict.fromkeys(dead[name] for name in (baseline, candidate) if name in dead))
    improvement = NOT_JUDGED if wrong else _borne_out(believed_pct, actual_pct)
    (consistency, credibility), of_baseline = (
        (consistency_of(tables["consistency"], name), credibility_of(tables["credibility"], name))
        for name in (candidate, baseline)
    )
    gain = (
        f"{candidate} is NOT JUDGED against {baseline}: {' and '.join(wrong)}; settle that first"
        if wrong
        else f"{candidate} {_believes(believed_pct, baseline)}; {_against_reference(rows, actual_pct, partly=partly)}: "
        f"{_CONCLUSION[improvement]}"
    )
    trust = _on_trust(_trust(consistency, credibility), _trust(*of_baseline), candidate, baseline)
    sentence = f"{gain}. {trust}"
    return Verdict(candidate, consistency, credibility, believed_pct, actual_pct, improvement, sentence)


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


def _against_reference(rows: pd.DataFrame, actual_pct: float, *, partly: bool) -> str:
    if not np.isfinite(actual_pct):
        missing = "the reference covers too little of the replay" if partly else "there is no reference"
        return f"{missing} to compare with"
    size = "smaller" if actual_pct >= 0 else "larger"
    change = f"the errors against the reference are {abs(actual_pct):.1f} % {size} in the median"
    if "position_h" not in rows.index:
        return change
    position = rows.loc["position_h"]
    return f"{change} (position {position['baseline_rmse']:.2f} m, now {position['rmse']:.2f} m)"


def _trust(consistency: str, credibility: str) -> str:
    """Join what innovations and errors say; the one word where they agree or only one of them speaks."""
    if credibility in (consistency, "too few") or credibility not in GRAVEST_FIRST:
        return consistency
    if consistency == "too few":
        return f"{credibility} against the reference"
    return f"{consistency} by the innovations and {credibility} against the reference"


def _on_trust(trust: str, of_baseline: str, candidate: str, baseline: str) -> str:
    if trust != of_baseline:
        return f"{candidate} is {trust}, {baseline} {of_baseline}."
    return "Too few updates to judge either." if trust == "too few" else f"Both filters are {trust}."
