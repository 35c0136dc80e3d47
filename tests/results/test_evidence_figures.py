"""Pictures of the evidence say where a filter has converged, and what outage is blind to."""

from collections.abc import Mapping

import numpy as np
import pytest

from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.evaluation.convergence import ConvergenceCurves
from insdvl_replay.evaluation.outage_test import OutageCurve
from insdvl_replay.show.plots.evidence import convergence_figure, outage_figure

S = 1_000_000_000
TIME_S = np.array([0.2, 0.9, 1.0, 10.0, 100.0])


def converging(limit: float = 0.01) -> Mapping[str, ConvergenceCurves]:
    falling = {"baseline": 1.0 / TIME_S, "aided": 0.5 / TIME_S}
    curves = ConvergenceCurves(
        TIME_S, falling, {name: np.full(5, 0.02) for name in falling}, limit
    )
    return {"velocity": curves, "heading": curves}


def evidence(
    quantity: str, name: str, baseline_s: float | None, value_s: float | None
) -> EvidenceRow:
    return EvidenceRow(
        "dive",
        name,
        "convergence",
        quantity,
        "s",
        baseline_s,
        value_s,
        0.5,
        samples=15,
        starts=15,
        role="settling",
    )


def test_each_filter_has_a_line_what_it_predicts_and_a_point_where_it_has_converged() -> None:
    rows = [
        evidence("convergence_velocity", "aided", 100.0, 50.0),
        evidence("convergence_heading", "aided", None, None),
    ]
    (figure,) = convergence_figure(converging(), rows)
    heading, velocity = figure.panels
    assert (heading.title, velocity.title) == ("heading [deg]", "horizontal velocity [m/s]")
    assert {curve.style for curve in heading.curves} == {
        "filter0",
        "filter1",
        "filter0 sigma",
        "filter1 sigma",
    }
    points = {
        curve.style: (curve.x.tolist(), curve.y.tolist())
        for curve in velocity.curves
        if curve.points
    }
    assert points == {"filter0 reached": ([100.0], [0.01]), "filter1 reached": ([50.0], [0.01])}
    assert heading.levels == (pytest.approx(0.01 / DEG),)
    assert (velocity.x_scale, velocity.y_scale) == ("log", "log")
    drawn = next(curve for curve in velocity.curves if curve.style == "filter1")
    assert drawn.x.tolist() == [1.0, 10.0, 100.0], "before a second there is no ping"
    assert list(convergence_figure({}, [])) == []


def test_outage_is_drawn_over_time_and_by_window_and_says_what_it_is_blind_to() -> None:
    over_time = np.arange(3.0), np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0, 5.0])
    curve = OutageCurve(*over_time, np.array([100, 130]) * S, np.array([2.0, 5.0]))
    (figure,) = outage_figure({"baseline": curve, "aided": curve}, Clock(0, 400 * S))
    assert "over 2 windows" in figure.caption
    drift, windows = figure.panels
    drawn = {curve.style: curve.y.tolist() for curve in drift.curves}
    assert drawn == {
        f"filter{n}{more}": y
        for n in (0, 1)
        for more, y in (("", [0, 1, 2]), (" sigma", [0, 2, 5]))
    }
    assert drift.y_scale == windows.y_scale == "log"
    assert (windows.curves[0].x.tolist(), windows.curves[0].y.tolist()) == (
        [100.0, 130.0],
        [2.0, 5.0],
    )
    assert list(outage_figure({}, Clock(0, S))) == []
