"""Errors of a known size come out as that size, wherever on Earth and however the vehicle points."""

from dataclasses import replace
from typing import Any

import numpy as np
import pyins.transform
import pytest
from frames import frame
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import REFERENCE_QUANTITIES
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.reference_errors import (
    ReferenceErrors,
    attitude_error,
    distance_travelled_m,
    reference_error_table,
    reference_errors,
)
from insdvl_replay.geometry.frames import north_east_down_m

SECOND = 1_000_000_000
REPEATABLE = settings(derandomize=True, deadline=None)
HAIFA_DEG_M = np.array([32.8, 34.9, -20.0])


def shifted(position: Floats, north_east_down: Floats) -> Floats:
    """Move positions (rad, rad, m) by metres, with somebody else's Earth."""
    degrees = position * [1 / DEG, 1 / DEG, 1.0]
    moved: Floats = pyins.transform.perturb_lla(degrees, north_east_down) * [DEG, DEG, 1.0]
    return moved


def attitudes(rpy_deg: Floats) -> Floats:
    made: Floats = Rotation.from_euler(
        "ZYX", np.atleast_2d(rpy_deg)[:, ::-1], degrees=True
    ).as_matrix()
    return made


def going_north(k: int = 11, step_m: float = 10.0) -> ReferenceColumns:
    """A reference that goes north by 10 m a second with a little roll, pitch and heading."""
    start = np.tile(HAIFA_DEG_M * [DEG, DEG, 1.0], (k, 1))
    return ReferenceColumns(
        SECOND * np.arange(k, dtype=np.int64),
        shifted(start, np.outer(step_m * np.arange(k), [1.0, 0.0, 0.0])),
        np.tile([step_m, 0.0, 0.0], (k, 1)),
        np.tile(attitudes(np.array([1.0, -2.0, 30.0])), (k, 1, 1)),
    )


def history_like(
    reference: ReferenceColumns,
    name: str = "aided",
    north_east_down: Floats | tuple[float, float, float] = (0.0, 0.0, 0.0),
    velocity: Floats | tuple[float, float, float] = (0.0, 0.0, 0.0),
    rotation_n: Floats | tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> History:
    """A filter that errs by metres, m/s, and a rotation vector in n."""
    k = len(reference.time_ns)
    return History(
        name,
        reference.time_ns,
        np.ones(k, dtype=bool),
        shifted(reference.position, np.broadcast_to(north_east_down, (k, 3))),
        reference.velocity_n + velocity,
        Rotation.from_rotvec(rotation_n).as_matrix() @ reference.mat_nb,
        np.zeros((k, 3)),
        np.zeros((k, 3)),
        np.ones((k, 12)),
        np.empty(0, dtype=np.int64),
        np.empty((0, 12, 12)),
        (),
    )


def table_of(*histories: History, reference: ReferenceColumns) -> Any:
    errors = {history.filter: reference_errors(history, reference) for history in histories}
    return frame(reference_error_table("dive", histories, errors)).set_index("quantity")


# --- Position.


@REPEATABLE
@given(
    st.floats(-80.0, 80.0),
    st.floats(-180.0, 180.0),
    st.floats(-6000.0, 100.0),
    st.tuples(*[st.floats(-50.0, 50.0)] * 3),
)
def test_position_error_is_in_metres_everywhere(
    latitude_deg: float, longitude_deg: float, height_m: float, moved: tuple[float, float, float]
) -> None:
    origin = np.array([[latitude_deg * DEG, longitude_deg * DEG, height_m]])
    # The curvature of the Earth over 50 m, steeper towards the poles.
    np.testing.assert_allclose(
        north_east_down_m(shifted(origin, np.array([moved])), origin), [moved], atol=5e-3
    )


@pytest.mark.parametrize(
    ("ours_deg", "theirs_deg", "sign"), [(-179.9999, 179.9999, 1.0), (179.9999, -179.9999, -1.0)]
)
def test_position_error_crosses_the_antimeridian(
    ours_deg: float, theirs_deg: float, sign: float
) -> None:
    ours, theirs = (
        np.array([[-17.0 * DEG, longitude * DEG, 0.0]]) for longitude in (ours_deg, theirs_deg)
    )
    over_greenwich = np.array([[-17.0 * DEG, 0.0001 * DEG, 0.0]])
    apart_m = north_east_down_m(over_greenwich, over_greenwich * [1.0, -1.0, 1.0])[0, 1]
    np.testing.assert_allclose(
        north_east_down_m(ours, theirs), [[0.0, sign * apart_m, 0.0]], atol=1e-6
    )
    assert apart_m == pytest.approx(2e-4 * 1852.0 * 60.0 * np.cos(17.0 * DEG), rel=0.01)


def test_distance_is_the_integral_of_horizontal_speed() -> None:
    reference = going_north()
    history = history_like(reference)
    assert distance_travelled_m(history, reference.time_ns) == pytest.approx(100.0, abs=1e-9)
    assert distance_travelled_m(history, reference.time_ns[:6]) == pytest.approx(50.0, abs=1e-9)
    assert distance_travelled_m(history, reference.time_ns[:0]) == 0.0
    diving = history_like(reference, velocity=(0.0, 0.0, 50.0))
    assert distance_travelled_m(diving, reference.time_ns) == pytest.approx(100.0, abs=1e-9)


def test_noise_of_the_reference_travels_no_distance() -> None:
    reference = going_north()
    noise = np.random.default_rng(1).normal(scale=5.0, size=(11, 3))
    noisy = replace(reference, position=shifted(reference.position, noise))
    assert reference_errors(history_like(reference), noisy).distance_m == pytest.approx(
        100.0, abs=1e-9
    )
    noisier = replace(
        reference,
        position=shifted(reference.position, 10.0 * noise),
        velocity_n=np.full((11, 3), np.nan),
    )
    assert reference_errors(history_like(reference), noisier).distance_m <= 100.0 + 1e-9


def test_all_filters_are_measured_by_the_way_of_the_reference() -> None:
    """A filter that flies off would make its own way longer, and what it is off by a smaller share of it."""
    reference = going_north()
    baseline, astray = (
        history_like(reference, "baseline"),
        history_like(reference, velocity=(500.0, 0.0, 0.0)),
    )
    for known in (reference, replace(reference, velocity_n=np.full((11, 3), np.nan))):
        assert reference_errors(astray, known, baseline).distance_m == pytest.approx(
            100.0, abs=1e-3
        )
        assert reference_errors(baseline, known, astray).distance_m == pytest.approx(
            100.0, abs=1e-3
        )


def test_way_is_that_of_the_baseline_where_the_reference_does_not_tell_it() -> None:
    """A dive between two fixes may end where it began."""
    reference = going_north()
    unseen = np.full((11, 3), np.nan)
    position = reference.position.copy()
    position[1:10] = np.nan
    surfaced = replace(reference, position=position, velocity_n=unseen)
    assert reference_errors(history_like(reference), surfaced).distance_m == pytest.approx(
        100.0, abs=1e-9
    )
    few = reference.velocity_n.copy()
    few[2:] = 0.0, 0.0, np.nan
    by_positions = reference_errors(
        history_like(reference), replace(reference, velocity_n=few)
    ).distance_m
    assert by_positions == pytest.approx(100.0, abs=1e-3)


# --- Attitude.


@REPEATABLE
@given(
    st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-180.0, 180.0)),
    st.integers(0, 2),
)
def test_small_attitude_error_is_the_difference_of_the_angles(
    rpy_deg: tuple[float, float, float], axis: int
) -> None:
    theirs = np.array(rpy_deg)
    ours = theirs + 0.01 * np.eye(3)[axis]
    error_deg = attitude_error(attitudes(ours), attitudes(theirs)) / DEG
    # Axes that lean by 5 deg share the error among them.
    np.testing.assert_allclose(
        error_deg, [0.01 * np.eye(3)[axis]], atol=0.01 * np.sin(5.5 * DEG) * 1.5
    )


@pytest.mark.parametrize(
    ("rpy_n_deg", "expected_deg"),
    [
        ((90.0, 0.0, 0.0), (0.0, -90.0, 0.0)),
        ((0.0, 120.0, 0.0), (120.0, 0.0, 0.0)),
        ((0.0, 0.0, -170.0), (0.0, 0.0, -170.0)),
    ],
)
def test_large_attitude_error_is_turned_to_the_vehicles_heading(
    rpy_n_deg: tuple[float, float, float], expected_deg: tuple[float, float, float]
) -> None:
    heading_east = attitudes(np.array([0.0, 0.0, 90.0]))
    ours = Rotation.from_rotvec(rpy_n_deg, degrees=True).as_matrix() @ heading_east
    np.testing.assert_allclose(attitude_error(ours, heading_east) / DEG, [expected_deg], atol=1e-9)


@pytest.mark.parametrize(
    ("ours_deg", "theirs_deg", "error_deg"), [(1.0, 359.0, 2.0), (359.0, 1.0, -2.0), (181, 179, 2)]
)
def test_heading_error_goes_the_short_way_round(
    ours_deg: float, theirs_deg: float, error_deg: float
) -> None:
    ours, theirs = (attitudes(np.array([0.0, 0.0, heading])) for heading in (ours_deg, theirs_deg))
    np.testing.assert_allclose(
        attitude_error(ours, theirs) / DEG, [[0.0, 0.0, error_deg]], atol=1e-9
    )


@pytest.mark.parametrize("pitch_deg", [89.0, 89.9999, 90.0, -90.0])
def test_attitude_error_near_the_vertical_stays_as_small_as_it_is(pitch_deg: float) -> None:
    theirs = attitudes(np.array([0.0, pitch_deg, 45.0]))
    tilt = Rotation.from_rotvec([0.1, -0.2, 0.05], degrees=True)
    error_deg = attitude_error(tilt.as_matrix() @ theirs, theirs) / DEG
    assert np.linalg.norm(error_deg) == pytest.approx(np.rad2deg(tilt.magnitude()), abs=1e-9)
    assert error_deg[0, 2] == pytest.approx(0.05, abs=1e-9)


# --- The comparison at the reference's times.


def test_known_errors_come_out_with_their_size_and_sign() -> None:
    reference = going_north()
    history = history_like(reference, north_east_down=(3.0, -4.0, -1.5), velocity=(0.1, -0.2, 0.3))
    table = table_of(history_like(reference, "baseline"), history, reference=reference)
    for quantity, error in (
        ("velocity_n", 0.1),
        ("velocity_e", -0.2),
        ("velocity_d", 0.3),
        ("depth", -1.5),
    ):
        assert table.loc[quantity, "rmse"] == pytest.approx(abs(error), abs=1e-4), quantity
        assert table.loc[quantity, "final"] == pytest.approx(error, abs=1e-4), quantity
    assert table.loc["position_h", "rmse"] == pytest.approx(5.0, abs=1e-4)
    # The way is the reference's, 10 m/s for 10 s, not what the filter's own velocity makes of it.
    assert table.loc["position_h_pct", "final"] == pytest.approx(5.0, abs=1e-4)
    assert (table["samples"] == 10).all(), (
        "the start, where a filter is set to the reference, does not count"
    )
    assert set(table["status"]) == {"compared"}


@pytest.mark.parametrize(("axis", "quantity"), [(0, "roll"), (1, "pitch"), (2, "heading")])
def test_attitude_errors_are_in_degrees(axis: int, quantity: str) -> None:
    reference = replace(going_north(), mat_nb=np.tile(np.eye(3), (11, 1, 1)))
    table = table_of(
        history_like(reference, "b"),
        history_like(reference, rotation_n=-0.5 * DEG * np.eye(3)[axis]),
        reference=reference,
    )
    for other in ("roll", "pitch", "heading"):
        expected = 0.5 if other == quantity else 0.0
        assert table.loc[other, "rmse"] == pytest.approx(expected, abs=1e-9)
        assert table.loc[other, "final"] == pytest.approx(-expected, abs=1e-9)


def test_rms_final_and_improvement_of_errors_that_change() -> None:
    reference = going_north(4)
    ours = history_like(
        reference, "aided", velocity=np.outer([9.0, 1.0, 2.0, -2.0], [1.0, 0.0, 0.0])
    )
    theirs = history_like(
        reference, "baseline", velocity=np.outer([9.0, 2.0, 4.0, 4.0], [1.0, 0.0, 0.0])
    )
    table = frame(
        reference_error_table(
            "dive",
            (theirs, ours),
            {h.filter: reference_errors(h, reference) for h in (theirs, ours)},
        )
    )
    assert table.columns.tolist() == [
        "log", "filter", "quantity", "unit", "baseline_rmse", "rmse", "improvement_pct",
        "baseline_final", "final", "samples", "status",
    ]  # fmt: skip
    assert table["quantity"].tolist() == list(REFERENCE_QUANTITIES)
    assert table["unit"].tolist() == ["m/s"] * 3 + ["deg"] * 3 + ["m", "m", "%"]
    first = table.iloc[0]
    assert first["rmse"] == pytest.approx(np.sqrt(3.0), abs=1e-9)
    assert first["baseline_rmse"] == pytest.approx(np.sqrt(12.0), abs=1e-9)
    assert first["improvement_pct"] == pytest.approx(50.0, abs=1e-6)
    assert (first["baseline_final"], first["final"]) == pytest.approx((4.0, -2.0), abs=1e-9)
    assert (first["log"], first["filter"], first["samples"]) == ("dive", "aided", 3)


@pytest.mark.parametrize(
    ("missing", "quantities"),
    [
        ("position", {"position_h", "depth", "position_h_pct"}),
        ("velocity_n", {"velocity_n", "velocity_e", "velocity_d"}),
        ("mat_nb", {"roll", "pitch", "heading"}),
    ],
)
def test_quantity_that_the_reference_lacks_is_said_to_be_missing(
    missing: str, quantities: set[str]
) -> None:
    reference = going_north()
    histories = (
        history_like(reference, "baseline"),
        history_like(reference, velocity=(0.1, 0.1, 0.1)),
    )
    partial = replace(reference, **{missing: np.full_like(getattr(reference, missing), np.nan)})
    table = table_of(*histories, reference=partial)
    assert set(table.index[table["status"] == "not in reference"]) == quantities
    absent = table.loc[sorted(quantities)]
    assert (
        absent[["baseline_rmse", "rmse", "improvement_pct", "baseline_final", "final"]]
        .isna()
        .all(axis=None)
    )
    assert (absent["samples"] == 0).all()
    assert (table.drop(index=sorted(quantities))["samples"] == 10).all()


def test_reference_without_depth_still_has_a_horizontal_position() -> None:
    reference = going_north()
    histories = (
        history_like(reference, "baseline"),
        history_like(reference, north_east_down=(3.0, 4.0, 5.0)),
    )
    flat = reference.position.copy()
    flat[:, 2] = np.nan
    table = table_of(*histories, reference=replace(reference, position=flat))
    assert table.loc["position_h", "rmse"] == pytest.approx(5.0, abs=1e-4)
    assert table.loc["depth", "status"] == "not in reference"


def test_rows_that_are_not_numbers_are_left_out_of_their_quantity_alone() -> None:
    reference = going_north()
    histories = (
        history_like(reference, "baseline"),
        history_like(reference, velocity=(0.1, 0.0, 0.0)),
    )
    velocity_n = reference.velocity_n.copy()
    velocity_n[[2, 10]] = np.nan
    table = table_of(*histories, reference=replace(reference, velocity_n=velocity_n))
    assert table.loc["velocity_n", "samples"] == 8
    assert table.loc["velocity_n", "rmse"] == pytest.approx(0.1, abs=1e-12)
    assert table.loc["velocity_n", "final"] == pytest.approx(0.1, abs=1e-12), (
        "of the last row that is known"
    )
    assert table.loc["heading", "samples"] == 10


def test_only_the_references_own_times_are_compared() -> None:
    reference = going_north()
    every = slice(3, None, 3)
    thin = ReferenceColumns(
        reference.time_ns[every],
        reference.position[every],
        reference.velocity_n[every],
        reference.mat_nb[every],
    )
    errors = reference_errors(
        history_like(reference, velocity=np.outer(np.arange(11.0), [0, 0, 1])), thin
    )
    assert errors.time_ns.tolist() == [3 * SECOND, 6 * SECOND, 9 * SECOND]
    np.testing.assert_allclose(errors.velocity_error_n[:, 2], [3.0, 6.0, 9.0])
    assert errors.distance_m == pytest.approx(90.0, abs=1e-3)


def test_reference_that_never_meets_the_replay_is_compared_with_nothing() -> None:
    reference = going_north()
    later = replace(reference, time_ns=reference.time_ns + 100 * SECOND)
    table = table_of(history_like(reference, "baseline"), history_like(reference), reference=later)
    assert set(table["status"]) == {"not in reference"}
    assert (table["samples"] == 0).all()


def test_vehicle_that_stays_has_no_error_in_percent() -> None:
    reference = going_north(step_m=0.0)
    histories = (
        history_like(reference, "baseline"),
        history_like(reference, north_east_down=(3.0, 4.0, 0.0)),
    )
    table = table_of(*histories, reference=reference)
    assert table.loc["position_h", "rmse"] == pytest.approx(5.0, abs=1e-4)
    assert table.loc["position_h_pct", "samples"] == 0
    assert table.loc["position_h_pct", ["rmse", "final"]].isna().all()


def test_dive_without_a_reference_says_so() -> None:
    reference = going_north()
    nothing: dict[str, ReferenceErrors] = {}
    histories = (
        history_like(reference, "baseline"),
        history_like(reference),
        history_like(reference, "third"),
    )
    table = frame(reference_error_table("dive", histories, nothing))
    assert table["filter"].tolist() == ["aided"] * 9 + ["third"] * 9
    assert set(table["status"]) == {"no reference"}
    assert (table["samples"] == 0).all()
    assert (
        table[["baseline_rmse", "rmse", "improvement_pct", "baseline_final", "final"]]
        .isna()
        .all(axis=None)
    )
