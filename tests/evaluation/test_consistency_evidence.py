"""Which filter is the more honest: by its gravest measurement and group of states, with what its gate rejected."""

from collections.abc import Sequence

import numpy as np
import pytest
from test_consistency import GATE, history

from insdvl_replay.core.tables import ConsistencyRow, CredibilityRow, EvidenceRow
from insdvl_replay.evaluation.consistency import consistency_table
from insdvl_replay.evaluation.evidence import Measured, evidence_table

Group = tuple[str, float, str]
"""Name, mean NEES over its degrees of freedom, and verdict."""


def credibility(filter_: str, groups: Sequence[Group]) -> list[CredibilityRow]:
    rows = [(name, 3, 3.0 * size, word) for name, size, word in groups]
    return [
        CredibilityRow("dive", filter_, name, dof, 9, mean, 0.5, 1.5, 68.0, 99.0, word, 9.0)
        for name, dof, mean, word in (
            *rows,
            ("heading", 1, 50.0, "overconfident"),
            ("all", 12, 12.0, "consistent"),
        )
    ]


def consistency(
    consistency: Sequence[ConsistencyRow] = (),
    before: Sequence[Group] = (),
    after: Sequence[Group] = (),
) -> dict[str, EvidenceRow]:
    rows = [*credibility("baseline", before), *credibility("aided", after)]
    return {
        row.quantity: row
        for row in evidence_table("dive", "baseline", ["aided"], Measured(), consistency, rows)
    }


FINE = ("velocity", 1.0, "consistent")


@pytest.mark.parametrize(
    ("before", "after", "values", "ratio"),
    [
        (
            [("velocity", 0.01, "conservative"), ("attitude", 3.0, "overconfident")],
            [FINE],
            (3.0, 1.0),
            1.0 / 3.0,
        ),
        (
            [FINE],
            [("velocity", 0.01, "conservative"), ("attitude", 1.5, "overconfident")],
            (1.0, 1.5),
            1.5,
        ),
        (
            [FINE],
            [FINE, ("attitude", 0.05, "conservative"), ("gyro_bias", 0.1, "conservative")],
            (1.0, 0.1),
            10.0,
        ),
        (
            [FINE, ("attitude", 9.0, "insufficient data")],
            [FINE, ("attitude", 0.1, "insufficient data")],
            (1.0, 1.0),
            1.0,
        ),
        ([("velocity", 9.0, "insufficient data")], [FINE], (9.0, 1.0), 1.0 / 9.0),
    ],
)
def test_gravest_group_of_errors_stands_for_a_filter(
    before: list[Group], after: list[Group], values: tuple[float, float], ratio: float
) -> None:
    row = consistency(before=before, after=after)["nees"]
    assert (row.baseline, row.value) == pytest.approx(values)
    # Of the distances from 1, to either side.
    assert (row.ratio, row.role) == (pytest.approx(ratio), "shown")


def test_no_group_that_was_compared_gives_no_row() -> None:
    assert not consistency(
        before=[("velocity", np.nan, "no reference")], after=[("velocity", np.nan, "no reference")]
    )


def test_rejected_pings_count_against_the_filter_that_rejects_them() -> None:
    """A filter that is surprised by a third of the pings, and hears none of them, is not the more honest for that."""
    surprised = np.where(np.arange(300) % 3 == 0, 1e4, 3.0)
    gated = history("aided", surprised, surprised < GATE)
    row = consistency(
        consistency_table("dive", (history("baseline", np.full(300, 3.0)), gated), {})
    )["nis"]
    assert (row.baseline, row.value) == pytest.approx((1.0, (2.0 * 3.0 + GATE) / 9.0))
    assert row.ratio == pytest.approx((2.0 * 3.0 + GATE) / 9.0)
