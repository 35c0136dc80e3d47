"""What is said of filters: verdicts, filters that are not evaluated, and what their gates reject."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from as_text import Cases, noted
from made_histories import history
from made_verdicts import evidence_row, judged

from insdvl_replay.evaluation.notes import update_notes
from insdvl_replay.evaluation.verdicts import diverged_filters
from insdvl_replay.preparation.prepared import outage_notes

UNSOUND = {"aided": "aided rejected 209 of 300"}
CAUTIOUS = {"of_aided": "conservative", "of_baseline": "conservative"}
CONFIDENT = {"of_aided": "overconfident"}
SMALLER = {"position": 0.8}
# Ratios of one dive by quantity, and what is said of both filters.
JUDGED: tuple[tuple[dict[str, float], dict[str, Any]], ...] = (
    (SMALLER, {}),
    ({"position": 0.8, "level": 1.4, "convergence_level": 0.7}, {}),
    ({"position": 3.5}, {"predicted_pct": -30.0}),
    ({"outage_60s": 0.8, "drift_60s": 1.2}, {}),
    ({"drift_60s": 0.8}, {}),
    ({"drift_60s": 0.8}, {"primary": "drift_60s"}),
    ({}, {}),
    (SMALLER, {"unsound": UNSOUND, "of_baseline": "overconfident"}),
    (SMALLER, {"unsound": {"aided": "the depth contradicts the track"}}),
    (SMALLER, {"errors_of_aided": "overconfident"}),
    (SMALLER, {**CONFIDENT, "errors_of_aided": "insufficient data"}),
    (SMALLER, {**CONFIDENT, "errors_of_aided": "no reference"}),
    (SMALLER, {**CONFIDENT, "errors_of_aided": "overconfident"}),
    (SMALLER, {"of_aided": "insufficient data", "errors_of_aided": "overconfident"}),
    (
        SMALLER,
        {
            **CAUTIOUS,
            "errors_of_aided": "insufficient data",
            "errors_of_baseline": "insufficient data",
        },
    ),
    (
        SMALLER,
        {
            **CAUTIOUS,
            "errors_of_aided": "overconfident",
            "errors_of_baseline": "insufficient data",
        },
    ),
)
ACTS = (0.0, 0.005, 0.03, 0.5)  # From a copy to a candidate that is another filter.


def said_of_filters(_: Path) -> Cases:
    """Return the sentences of candidates, and of filters that are not evaluated."""
    for ratios, named in JUDGED:
        rows = [evidence_row(quantity, ratio) for quantity, ratio in ratios.items()]
        yield f"{ratios} {named or ''}".rstrip(), judged(rows, **named).sentence
    for acts in ACTS:
        rows = [evidence_row(quantity, 1.0, acts=acts) for quantity in ("position", "level")]
        yield f"acts by {acts:g}", judged(rows).sentence
    many = history("many", np.full(100, 3.0), np.arange(100) >= 11)
    lost = history("lost", np.full(300, 3.0))
    lost = replace(
        lost, innovations=(replace(lost.innovations[0], gate=25.9, reopened=np.arange(300) < 4),)
    )
    broken = replace(
        history("broken", np.full(100, 3.0)), velocity_n=np.array([[0.0, np.nan, 0.0]])
    )
    blind = replace(history("blind", np.full(100, 3.0)), sd=np.full((1, 12), np.nan))
    yield (
        "filters that are not evaluated",
        "\n".join(diverged_filters((many, lost, broken, blind)).values()),
    )
    yield "gates that reject much", noted(update_notes((many,)))
    for name, pings_s in (
        ("one long outage", [*range(1, 300), *range(601, 2000)]),
        ("outages at both ends", range(400, 900)),
    ):
        pings_ns = np.array(pings_s, dtype=np.int64) * 1_000_000_000
        yield name, noted(outage_notes(pings_ns, 0, 2_000_000_000_000))
