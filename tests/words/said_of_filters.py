"""What is said of filters: verdicts, filters that are not evaluated, and what their gates reject."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from as_text import Cases, noted
from made_histories import history
from made_verdicts import judged

from insdvl_replay.evaluation.notes import update_notes
from insdvl_replay.evaluation.verdicts import diverged_filters
from insdvl_replay.preparation.prepared import outage_notes

UNSOUND = {"aided": "aided rejected 209 of 300"}
CAUTIOUS = {"of_aided": "conservative", "of_baseline": "conservative"}
CONFIDENT = {"of_aided": "overconfident"}
JUDGED: tuple[tuple[tuple[Any, ...], dict[str, Any]], ...] = (
    ((["better"],), {}),
    ((["better"], 40.0, (0.6, 0.5, 0.7)), {"of_consistency": "better"}),
    ((["better"],), {"of_consistency": "worse"}),
    ((["better"], -30.0), {}),
    ((["better"],), {"kind": "outage"}),
    ((["better"],), {"kind": "outage", "samples": 0}),
    ((["better"],), {"independent": False}),
    ((["worse"], 40.0, (1.75, 1.5, 2.0)), {"of_consistency": "worse", **CONFIDENT}),
    ((["worse"],), {"of_consistency": "better"}),
    ((["better", "worse"],), {}),
    ((["equivalent"], 40.0, (1.0, 0.99, 1.01)), {"starts": 1}),
    ((["equivalent", "undecided", "equivalent", "undecided"],), {}),
    ((["undecided", "equivalent"],), {}),
    (([],), {}),
    ((["better"],), {"unsound": UNSOUND, "of_baseline": "overconfident"}),
    ((["better"],), {"unsound": {"baseline": "baseline rejected 209 of 300"}, "of_baseline": "overconfident"}),
    ((["undecided"],), {"errors_of_aided": "overconfident"}),
    ((["undecided"],), {**CONFIDENT, "errors_of_aided": "insufficient data"}),
    ((["undecided"],), {**CONFIDENT, "errors_of_aided": "no reference"}),
    ((["undecided"],), {**CONFIDENT, "errors_of_aided": "overconfident"}),
    ((["undecided"],), {"of_aided": "insufficient data", "errors_of_aided": "overconfident"}),
    ((["undecided"],), {**CAUTIOUS, "errors_of_aided": "insufficient data", "errors_of_baseline": "insufficient data"}),
    ((["undecided"],), {**CAUTIOUS, "errors_of_aided": "overconfident", "errors_of_baseline": "insufficient data"}),
)


def said_of_filters(_: Path) -> Cases:
    """Return the sentences of candidates, and of filters that are not evaluated."""
    for positional, named in JUDGED:
        yield f"{positional} {named or ''}".rstrip(), judged(*positional, **named).sentence
    many = history("many", np.full(100, 3.0), np.arange(100) >= 11)
    lost = history("lost", np.full(300, 3.0))
    lost = replace(lost, innovations=(replace(lost.innovations[0], gate=25.9, reopened=np.arange(300) < 4),))
    broken = replace(history("broken", np.full(100, 3.0)), velocity_n=np.array([[0.0, np.nan, 0.0]]))
    blind = replace(history("blind", np.full(100, 3.0)), sd=np.full((1, 12), np.nan))
    yield "filters that are not evaluated", "\n".join(diverged_filters((many, lost, broken, blind)).values())
    yield "gates that reject much", noted(update_notes((many,)))
    for name, pings_s in (
        ("one long outage", [*range(1, 300), *range(601, 2000)]),
        ("outages at both ends", range(400, 900)),
    ):
        pings_ns = np.array(pings_s, dtype=np.int64) * 1_000_000_000
        yield name, noted(outage_notes(pings_ns, 0, 2_000_000_000_000))
