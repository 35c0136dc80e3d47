"""Rows of evidence with given ratios, and the verdict on a candidate of one dive."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from insdvl_replay.core.quantities import PRIMARIES, REFERENCE_QUANTITIES, SECONDARIES, TRACK
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
from insdvl_replay.core.words import Role
from insdvl_replay.evaluation.verdicts import verdicts


def kind_of(quantity: str) -> str:
    """Return the kind of evidence of a quantity."""
    kinds = {"outage": "outage", "held_out": "held_out", "convergence": "convergence"}
    found = (kind for start, kind in kinds.items() if quantity.startswith(start))
    return next(found, "track" if quantity in TRACK else "accuracy")


def evidence_row(
    quantity: str,
    ratio: float,
    *,
    acts: float = 0.5,
    noise: float = 0.0,
    role: str | None = None,
    log: str = "dive",
) -> EvidenceRow:
    """Return a row of one dive on a baseline with an error of 2."""
    kind = kind_of(quantity)
    if role is None:
        is_secondary = any(quantity in names for names in SECONDARIES.values())
        role = (
            Role.PRIMARY
            if quantity in PRIMARIES
            else Role.SECONDARY
            if is_secondary
            else Role.SHOWN
        )
        role = Role.SETTLING if kind == "convergence" else role
    is_settling = kind == "convergence"
    return EvidenceRow(
        log=log,
        filter="aided",
        evidence=kind,
        quantity=quantity,
        unit="s" if is_settling else "m",
        baseline=2.0,
        value=2.0 * ratio,
        ratio=ratio,
        moves=None if is_settling else 2.0 * acts,
        acts=None if is_settling else acts,
        reference_noise=None if is_settling else noise,
        samples=60,
        role=role,
    )


def judged(
    rows: Sequence[EvidenceRow] = (),
    predicted_pct: float = 40.0,
    of_aided: str = "consistent",
    of_baseline: str = "consistent",
    errors_of_aided: str = "consistent",
    errors_of_baseline: str = "consistent",
    unsound: Mapping[str, str] = MappingProxyType({}),
    primary: str = "",
) -> CandidateVerdict:
    """Judge a candidate of one dive whose states all improved alike, by these rows of evidence."""
    row = "dive", "aided"
    tables = Tables(
        [
            ImprovementRow(*row, state.id, state.unit, 1.0, 1.0, predicted_pct, "improved")
            for state in STATES
        ],
        [
            ConvergenceRow(*row, state.id, state.unit, 1.0, 9.0, 9.0, 0.0, "reached")
            for state in STATES
        ],
        [
            ReferenceErrorRow(*row, quantity, unit, 2.0, 1.6, 20.0, 0.0, 0.0, 9, "compared")
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
        [*rows, EvidenceRow(*row, "consistency", "nis", "", 2.0, 1.0, 0.5)],
    )
    return verdicts(tables, "baseline", ["aided"], unsound, primary)["aided"]


def consistency(filter_: str, measurement: str, verdict: str) -> ConsistencyRow:
    return ConsistencyRow("dive", filter_, measurement, 3, 9, 0, 3.0, 2.0, 4.0, verdict)


def of_errors(filter_: str, attitude: str) -> list[CredibilityRow]:
    """Velocities that are consistent where the attitude could be judged, and all states together always."""
    velocity = attitude if attitude in {"no reference", "insufficient data"} else "consistent"
    rows = (
        ("heading", "insufficient data"),
        ("velocity", velocity),
        ("attitude", attitude),
        ("all", "consistent"),
    )
    return [credibility(filter_, *row) for row in rows]


def credibility(filter_: str, quantity: str, verdict: str) -> CredibilityRow:
    return CredibilityRow("dive", filter_, quantity, 1, 9, 1.0, 0.5, 1.5, 68.0, 99.0, verdict, 9.0)
