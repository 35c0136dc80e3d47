"""A candidate that is judged by pieces of evidence that say given words."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from insdvl_replay.core.quantities import EVIDENCE_QUANTITIES, REFERENCE_QUANTITIES
from insdvl_replay.core.states import STATES
from insdvl_replay.core.tables import (
    CandidateVerdict,
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    EvidenceRow,
    ImprovementRow,
    ReferenceErrorRow,
    Tables,
)
from insdvl_replay.evaluation.verdicts import verdicts


def judged(
    words: Sequence[str],
    predicted_pct: float = 40.0,
    ratio: tuple[float, float, float] = (0.8, 0.7, 0.9),
    of_aided: str = "consistent",
    of_baseline: str = "consistent",
    errors_of_aided: str = "consistent",
    errors_of_baseline: str = "consistent",
    unsound: Mapping[str, str] = MappingProxyType({}),
    of_consistency: str = "equivalent",
    independent: bool = True,
    kind: str = "accuracy",
    samples: int = 9,
    starts: int = 16,
) -> CandidateVerdict:
    """Judge a candidate whose states all improved alike, by pieces of evidence that say these words."""
    row = "dive", "aided"
    pieces = [
        EvidenceRow(*row, kind, quantity, "m", 2.0, 2.0 * ratio[0], *ratio, 30.0, starts, 60, word)
        for quantity, word in zip(EVIDENCE_QUANTITIES, words, strict=False)
    ]
    pieces.append(EvidenceRow(*row, "consistency", "nis", "", 2.0, 1.0, 0.5, None, None, None, 1, 0, of_consistency))
    tables = Tables(
        [ImprovementRow(*row, state.id, state.unit, 1.0, 1.0, predicted_pct, "improved") for state in STATES],
        [ConvergenceRow(*row, state.id, state.unit, 1.0, 9.0, 9.0, 0.0, "reached") for state in STATES],
        [
            ReferenceErrorRow(*row, quantity, unit, 2.0, 1.6, 20.0, 0.0, 0.0, samples, "compared")
            for quantity, unit in REFERENCE_QUANTITIES.items()
        ],
        [
            consistency("baseline", "velocity", of_baseline),
            consistency("aided", "velocity", of_aided),
            consistency("aided", "acceleration", of_aided),
        ],
        [
            row
            for name, attitude in (("baseline", errors_of_baseline), ("aided", errors_of_aided))
            for row in of_errors(name, attitude)
        ],
        pieces,
    )
    return verdicts(tables, "baseline", ["aided"], unsound, independent=independent)["aided"]


def consistency(filter_: str, measurement: str, verdict: str) -> ConsistencyRow:
    return ConsistencyRow("dive", filter_, measurement, 3, 9, 0, 3.0, 2.0, 4.0, verdict)


def of_errors(filter_: str, attitude: str) -> list[CredibilityRow]:
    """Velocities that are consistent where the attitude could be judged, and all states together always."""
    velocity = attitude if attitude in {"no reference", "insufficient data"} else "consistent"
    rows = ("heading", "insufficient data"), ("velocity", velocity), ("attitude", attitude), ("all", "consistent")
    return [credibility(filter_, *row) for row in rows]


def credibility(filter_: str, quantity: str, verdict: str) -> CredibilityRow:
    return CredibilityRow("dive", filter_, quantity, 1, 9, 1.0, 0.5, 1.5, 68.0, 99.0, verdict, 9.0)
