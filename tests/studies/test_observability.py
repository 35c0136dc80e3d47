"""Observability: ranks, and the directions that nothing shows, against closed forms and the paper's own subspaces."""

from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
from instants import instants
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

from insdvl_replay.batch import studies
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.history import History
from insdvl_replay.core.states import BA, BG, DV, PHI, STATES
from insdvl_replay.document.parts import Result
from insdvl_replay.document.render import save_result
from insdvl_replay.geometry.earth import normal_gravity
from insdvl_replay.geometry.rotation import mat_from_rpy, skew
from insdvl_replay.logs.write import write_dive
from insdvl_replay.nav.measurements import PUBLISHED, VELOCITY, Measurement
from insdvl_replay.nav.observability import (
    NominalPings,
    analyse,
    jacobians,
    named_directions,
    nominal_pings,
    remaining_cov,
    whitened_rows,
)
from insdvl_replay.nav.timeline import Timeline, build_timeline
from insdvl_replay.preparation.replay import replay_dive, replay_log
from insdvl_replay.sim import dive as sim_dive
from insdvl_replay.sim.dive import exact_dive, simulate_dive
from insdvl_replay.sim.trajectories import SCENARIOS, START, Scenario, Segment, Wave
from insdvl_replay.studies import observability
from insdvl_replay.studies.observability import study_observability

TURN = (Segment(100.0), Segment(20.0, 60.0))
GRAVITY = float(normal_gravity(START[0], START[2]))


@pytest.fixture(scope="module", autouse=True)
def _turns() -> Iterator[None]:
    """Two more scenarios: a straight line with a turn of 60 deg in 20 s, at steady speed and at one that changes."""
    more = {
        "turn": Scenario("", 424.0, Wave(2.0), TURN),
        "weave": Scenario("", 424.0, Wave(2.0, 0.3, 60.0), TURN),
    }
    with pytest.MonkeyPatch.context() as patch:
        for module in (sim_dive, observability):
            patch.setattr(module, "SCENARIOS", MappingProxyType({**SCENARIOS, **more}))
        yield


def study(scenario: str, *, earth_rate: bool) -> Result:
    return study_observability(scenario, load_config("levy-klein"), earth_rate=earth_rate)


def ranks(report: Result) -> dict[str, int]:
    return dict(zip(report.tables["ranks"]["aiding"], report.tables["ranks"]["rank"], strict=True))


def unobservable(report: Result, aiding: str) -> set[str]:
    rows = report.tables["directions"]
    return set(
        rows.loc[(rows["aiding"] == aiding) & (rows["status"] == "unobservable"), "direction"]
    )


def exact_nominal(scenario: str) -> tuple[Timeline, History]:
    """The exact motion as a history, recorded at each sample."""
    dive = exact_dive(scenario, reference_rate_hz=100.0)
    assert dive.reference is not None
    time_ns = dive.reference.time_ns
    timeline = build_timeline(
        dive.imu, time_ns[100::100], time_ns, int(time_ns[0]), int(time_ns[-1])
    )
    rows = len(timeline.event_ns)
    history = History(
        filter="exact",
        time_ns=timeline.event_ns,
        updated=timeline.ping >= 0,
        position=dive.reference.position,
        velocity_n=dive.reference.velocity_n,
        mat_nb=dive.reference.mat_nb,
        accel_bias_b=np.zeros((rows, 3)),
        gyro_bias_b=np.zeros((rows, 3)),
        sd=np.ones((rows, 12)),
        cov_ns=timeline.event_ns[:0],
        cov=np.empty((0, 12, 12)),
        innovations=(),
    )
    return timeline, history


# --- The transition.


def test_transition_is_the_papers_closed_form_with_its_sign_mended() -> None:
    """Phi = [I, S, R, M; 0, I, 0, R; ...] with S = -int [f x], R = int C, M = -int [f x] R, where the Earth stands."""
    timeline, nominal = exact_nominal("weave")
    transition = nominal_pings(timeline, nominal, np.zeros(12), earth_rate=False).transition
    scenario, time_s = Scenario("", 424.0, Wave(2.0, 0.3, 60.0), TURN), instants(timeline).time_s
    mat_nb = mat_from_rpy(scenario.rpy(time_s))
    velocity_b, rate_b = (
        scenario.velocity_b(time_s),
        scenario.rpy_rate(time_s),
    )  # level: the rate is that of the heading
    acceleration_b = scenario.velocity_rate_b(time_s) + np.cross(rate_b, velocity_b)
    force_n = skew(np.einsum("kij,kj->ki", mat_nb, acceleration_b) - [0.0, 0.0, GRAVITY])

    def integral(values: Floats) -> Floats:
        total: Floats = cumulative_simpson(values, x=time_s, axis=0, initial=0.0)
        return total

    R = integral(mat_nb)
    blocks = {(0, 3): -integral(force_n), (0, 6): R, (0, 9): -integral(force_n @ R), (3, 9): R}
    pings = np.flatnonzero(timeline.ping >= 0)
    for (row, column), expected in blocks.items():
        found = transition[:, row : row + 3, column : column + 3]
        np.testing.assert_allclose(
            found, expected[pings], rtol=0.0, atol=2e-4 * np.abs(expected).max()
        )
    np.testing.assert_allclose(
        transition[:, DV, DV], np.broadcast_to(np.eye(3), (len(pings), 3, 3)), atol=1e-12
    )


def test_history_of_another_time_line_is_refused() -> None:
    timeline, _ = exact_nominal("straight")
    _, other = exact_nominal("weave")
    with pytest.raises(ValueError, match="other times"):
        nominal_pings(
            timeline, History(**{**other.__dict__, "time_ns": other.time_ns + 1}), np.zeros(12)
        )


def test_rows_are_in_units_of_the_measurements_noise() -> None:
    pings = NominalPings(
        np.zeros((2, 3)),
        np.tile(np.eye(3), (2, 1, 1)),
        np.zeros((2, 3)),
        np.ones(2),
        *np.tile(np.eye(12), (3, 2, 1, 1)),
    )
    cov_b = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 1.0]])
    measurement = Measurement(
        name="velocity",
        unit="m/s",
        kind=VELOCITY,
        sensor=0,
        available=np.array([False, True]),
        valid_ns=np.arange(2),
        values=np.zeros((2, 3)),
        cov=np.tile(cov_b, (2, 1, 1)),
    )
    rows = whitened_rows(pings, measurement, np.array([1.0, 0.0, 0.0]))
    H = np.hstack([np.eye(3), np.zeros((3, 6)), -skew(np.array([1.0, 0.0, 0.0]))])
    np.testing.assert_allclose(rows.T @ rows, H.T @ np.linalg.inv(cov_b) @ H, atol=1e-12)


# --- The decomposition.


def test_decomposition_is_that_of_the_whole_stack() -> None:
    rng = np.random.default_rng(5)
    rows, prior_sd = rng.normal(size=(50, 12)), rng.uniform(0.1, 2.0, 12)
    found = analyse(rows, prior_sd, 1e-6)
    np.testing.assert_allclose(
        found.singular_values, np.linalg.svd(rows * prior_sd, compute_uv=False), rtol=1e-10
    )
    direction = rng.normal(size=12)
    direction /= np.linalg.norm(direction)
    assert found.response(direction) == pytest.approx(np.linalg.norm(rows * prior_sd @ direction))
    posterior = np.linalg.inv(np.diag(prior_sd**-2) + rows.T @ rows)
    np.testing.assert_allclose(found.left() * prior_sd, np.sqrt(np.diag(posterior)), rtol=1e-9)
    assert found.rank == 12
    assert np.isnan(found.gap)


def test_rank_is_counted_down_to_the_tolerance() -> None:
    rows = np.diag([1e3, 1.0, 1e-2, 1e-9, *[0.0] * 8])
    found = analyse(rows, np.ones(12), 1e-6)
    assert found.rank == 3
    assert found.gap == pytest.approx(1e7)
    np.testing.assert_allclose(found.unobservable[:, :3], 0.0, atol=1e-12)
    assert analyse(np.empty((0, 12)), np.ones(12), 1e-6).rank == 0
    assert analyse(np.eye(12)[:2], np.ones(12), 1e-6).gap == np.inf


# --- Ranks and names.

PAIRS = {"phi_n held", "phi_e held", "phi_d held"}
VELOCITY_ERRORS = {"dv_n", "dv_e", "dv_d"}


@pytest.mark.parametrize(
    ("scenario", "earth_rate", "velocity", "published", "windowed"),
    [
        ("straight", False, 8, 5, 5),
        ("straight", True, 9, 6, 6),
        ("turn", False, 10, 7, 9),
        ("turn", True, 12, 10, 11),
        ("figure-eight", False, 11, 8, 11),
        ("figure-eight", True, 12, 10, 12),
        ("static", False, 8, 5, 5),
    ],
)
def test_ranks(
    scenario: str, earth_rate: bool, velocity: int, published: int, windowed: int
) -> None:
    report = study(scenario, earth_rate=earth_rate)
    assert ranks(report) == {
        "velocity": velocity,
        "published": published,
        "windowed": windowed,
        "velocity + published": velocity,
        "velocity + windowed": velocity,
    }
    assert (report.tables["ranks"]["unnamed"] == 0).all()


def test_straight_line_hides_two_pairs_heading_and_a_gyro_bias() -> None:
    report = study("straight", earth_rate=False)
    assert unobservable(report, "velocity") == {*PAIRS, "bg_d held"}
    assert unobservable(report, "windowed") == {*PAIRS, *VELOCITY_ERRORS, "bg_d held"}
    assert unobservable(report, "published") == {*PAIRS, *VELOCITY_ERRORS, "bg_d"}
    gaps = report.tables["ranks"].set_index("aiding")["gap"]
    assert (gaps[["velocity", "published", "windowed"]] > 1e6).all()
    assert "heading" in report.sentences[0]


def test_heading_stays_hidden_in_a_turn_where_the_earth_is() -> None:
    """Nothing but the Earth's rate tells where north is: the way can be turned as a whole."""
    for scenario in ("turn", "weave"):
        report = study(scenario, earth_rate=False)
        assert "phi_d held" in unobservable(report, "velocity")
    assert unobservable(study("turn", earth_rate=False), "velocity") == {"phi_d held", "bg_d held"}
    assert unobservable(study("turn", earth_rate=True), "windowed") == {"dv_d"}


def test_named_directions_have_the_ratios_of_gravity_and_speed() -> None:
    speed_mps, mat_nb = 2.0, mat_from_rpy(np.array([0.1, -0.2, 0.5]))
    velocity_n = mat_nb @ [speed_mps, 0.0, 0.0]
    directions = {
        d.id: d.error
        for d in named_directions(np.array(START), velocity_n, mat_nb, earth_rate=False)
    }
    for axis, name in enumerate(("phi_n held", "phi_e held", "phi_d held")):
        phi = np.eye(3)[axis]
        np.testing.assert_allclose(directions[name][PHI], phi)
        np.testing.assert_allclose(
            mat_nb @ directions[name][BA], -np.cross([0.0, 0.0, GRAVITY], phi), atol=1e-12
        )
        np.testing.assert_allclose(directions[name][DV], -np.cross(velocity_n, phi), atol=1e-12)
    np.testing.assert_allclose(mat_nb @ directions["bg_d held"][BG], [0.0, 0.0, 1.0], atol=1e-12)
    assert np.linalg.norm(directions["bg_d held"][BA]) == pytest.approx(
        np.linalg.norm(velocity_n[:2])
    )


def test_turning_earth_adds_the_gyro_bias_that_holds_a_misalignment() -> None:
    report = study("straight", earth_rate=True)
    assert unobservable(report, "velocity") == PAIRS
    catalogue = report.tables["catalogue"].set_index("direction")
    north_rate_degph = 15.04107 * np.cos(START[0])
    heading = catalogue.loc["phi_d held"]
    assert np.hypot(heading["bg_x"], heading["bg_y"]) == pytest.approx(
        1e-3 * north_rate_degph, rel=3e-3
    )


# --- The paper's subspaces.


def test_papers_subspace_has_the_other_sign_in_its_matrix() -> None:
    """Its matrix U, read by rows as it is printed, has u3 = [g x] u2; hidden is u3 = -[g x] u2, as in its (52)."""
    report = study("straight", earth_rate=False)
    values = report.tables["singular_values"]
    pairs = values[(values["aiding"] == "published") & (values["number"] > 5)]
    phi, ba = (
        pairs[["phi_n", "phi_e", "phi_d"]].to_numpy(),
        pairs[["ba_x", "ba_y", "ba_z"]].to_numpy(),
    )
    mat_nb = mat_from_rpy(np.array([0.0, 0.0, np.pi / 6.0]))
    level_mg = (
        -np.cross([0.0, 0.0, GRAVITY / 9.80665], phi) @ mat_nb
    )  # 1 mrad tilts gravity by 1 mg
    np.testing.assert_allclose(ba, level_mg, rtol=0.0, atol=1e-6)
    assert np.abs(ba).max() > 1.0


def test_accelerations_do_not_have_the_unobservable_subspace_of_velocities() -> None:
    """They lack the three velocity errors, and need no velocity error beside a heading error."""
    report = study("straight", earth_rate=False)
    assert unobservable(report, "published") - unobservable(report, "velocity") == {
        *VELOCITY_ERRORS,
        "bg_d",
    }
    assert ranks(report)["velocity + published"] == ranks(report)["velocity"]
    at_rest = study("static", earth_rate=False)
    assert (
        unobservable(at_rest, "published") - unobservable(at_rest, "velocity") == VELOCITY_ERRORS
    )


# --- What is left, with process noise and without.


def random_pings(pings: int, *, noise: float, seed: int = 6) -> NominalPings:
    """Motions that never were: transitions near one, and the noise of a filter, for matrices in numpy to work on."""
    rng = np.random.default_rng(seed)
    step = np.eye(12) + 0.1 * rng.normal(size=(pings, 12, 12))
    transition = np.array(
        [np.linalg.multi_dot([np.eye(12), *step[k::-1], np.eye(12)]) for k in range(pings)]
    )
    root = noise * rng.normal(size=(pings, 12, 12))
    mat_nb = Rotation.random(pings, random_state=seed).as_matrix()
    velocity_n, rate_nb_b = rng.normal(size=(2, pings, 3))
    return NominalPings(
        velocity_n,
        mat_nb,
        rate_nb_b,
        np.full(pings, 9.8),
        transition,
        step,
        root @ np.swapaxes(root, 1, 2),
    )


def random_measurements(pings: int) -> list[Measurement]:
    """Velocities and published accelerations, each missing at some pings."""
    rng = np.random.default_rng(7)
    found = []
    for kind in (VELOCITY, PUBLISHED):
        root = rng.normal(size=(pings, 3, 3))
        cov_b = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(3)
        available, values = rng.random(pings) < 0.7, np.zeros((pings, 3))
        found.append(Measurement("", "", kind, np.arange(pings), values, cov_b, available))
    return found


def test_covariance_is_carried_on_as_a_textbook_has_it() -> None:
    pings, measurements, prior_sd = (
        random_pings(9, noise=0.2),
        random_measurements(9),
        np.linspace(0.5, 2.0, 12),
    )
    arm_b = np.array([1.0, 0.2, -0.3])
    P = np.diag(prior_sd**2)
    for ping in range(9):
        P = pings.step[ping] @ P @ pings.step[ping].T + pings.noise[ping]
        for measurement in measurements:
            if measurement.available[ping]:
                H = jacobians(pings, measurement, arm_b)[ping]
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + measurement.cov[ping])
                P = (np.eye(12) - K @ H) @ P
    found = remaining_cov(pings, measurements, arm_b, prior_sd)
    np.testing.assert_allclose(found, P, rtol=0.0, atol=1e-10 * np.abs(P).max())
    np.testing.assert_array_equal(found, found.T)


def test_without_process_noise_the_end_is_the_start_carried_on() -> None:
    """The stack tells what is left of the errors at the start; at the last ping they have grown by the transition."""
    pings, measurements, prior_sd = (
        random_pings(9, noise=0.0),
        random_measurements(9),
        np.linspace(0.5, 2.0, 12),
    )
    arm_b = np.zeros(3)
    rows = np.vstack([whitened_rows(pings, measurement, arm_b) for measurement in measurements])
    at_start = np.linalg.inv(np.diag(prior_sd**-2) + rows.T @ rows)
    np.testing.assert_allclose(
        analyse(rows, prior_sd).left() * prior_sd, np.sqrt(np.diag(at_start)), rtol=1e-9
    )
    expected = pings.transition[-1] @ at_start @ pings.transition[-1].T
    found = remaining_cov(pings, measurements, arm_b, prior_sd)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def left_sd(report: Result, aiding: str) -> Floats:
    """Standard deviations after the last ping, SI units."""
    rows = report.tables["states"]
    return np.asarray(rows.loc[rows["aiding"] == aiding, "left_sd"]) * [
        state.factor for state in STATES
    ]


def last_updated_sd(history: History) -> Floats:
    last: Floats = history.sd[np.flatnonzero(history.updated)[-1]]
    return last


def test_what_is_left_is_what_the_filter_predicts_after_the_last_ping() -> None:
    """Along the exact motion nothing is corrected, and the recursion is that of the filter with the same aiding."""
    config = load_config("levy-klein")
    dive = exact_dive("figure-eight", lever_arm_m=config.dvl.lever_arm_m)
    velocity, aided = replay_dive(dive, config).histories
    windowed = config.filters["aided"].acceleration
    assert windowed is not None
    assert windowed.model == "windowed"
    report = study("figure-eight", earth_rate=True)
    np.testing.assert_allclose(left_sd(report, "velocity"), last_updated_sd(velocity), rtol=1e-6)
    np.testing.assert_allclose(
        left_sd(report, "velocity + windowed"), last_updated_sd(aided), rtol=1e-6
    )


def test_left_after_the_last_ping_may_be_more_than_at_the_start() -> None:
    """Nothing shows the heading on a level way, and what is known of the gyros leaves it to drift: 10 deg/h, 424 s."""
    report = study("straight", earth_rate=True)
    rows = report.tables["states"].set_index(["aiding", "state"])
    heading = rows.loc[("velocity", "phi_d")]
    drifted_deg = np.hypot(0.5, 10.0 / 3600.0 * 423.4)
    assert heading["left_pct"] == pytest.approx(100.0 * drifted_deg / 0.5, rel=0.01)
    assert heading["left_without_noise_pct"] < 100.0
    (sentence,) = (
        text for text in report.sentences if text.startswith("velocity: sigma is larger")
    )
    assert f"misalignment, down ({heading['left_pct']:.0f} %)" in sentence


def test_what_is_left_on_a_real_dive_is_what_its_filters_predict(snapir: Path) -> None:
    log, config = (
        snapir / "snapir_02.mcap",
        load_config(file=Path(__file__).parents[2] / "examples" / "snapir.toml"),
    )
    report, (velocity, windowed, _) = (
        study_observability(str(log), config),
        replay_log(log, config).histories,
    )
    np.testing.assert_allclose(left_sd(report, "velocity"), last_updated_sd(velocity), rtol=2e-3)
    np.testing.assert_allclose(
        left_sd(report, "velocity + windowed"), last_updated_sd(windowed), rtol=2e-3
    )


# --- Logs and the command.


def test_log_is_studied_like_a_scenario(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "dive.mcap"
    write_dive(log, simulate_dive("figure-eight", duration_s=200.0, imu_rate_hz=50.0))
    arguments = ["study", "observability", str(log), "--start", "50", "--end", "180", "--png"]
    for name in ("one", "two"):
        assert run_command_line([*arguments, "-o", str(tmp_path / name)]) == 0
    assert "velocity: rank 12 of 12" in capsys.readouterr().out
    folders = [tmp_path / name / "observability-dive" for name in ("one", "two")]
    names = {path.name for path in folders[0].iterdir()}
    tables = {"ranks.csv", "directions.csv", "catalogue.csv", "singular_values.csv", "states.csv"}
    assert names == tables | {
        "singular_values.svg",
        "singular_values.png",
        "config.toml",
        "report.json",
        "report.html",
    }
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()
    assert len(pd.read_csv(folders[0] / "states.csv")) == 5 * 12


def test_settings_of_one_vehicle_do_not_bend_a_scenario() -> None:
    overrides = [
        "dvl.scale=1.1",
        "initial.source=level",
        "initial.accel_bias_mg=[5, 5, 5]",
        "initial.heading_deg=0.0",
    ]
    bent = study_observability(
        "straight", load_config("levy-klein", overrides=overrides), earth_rate=False
    )
    pd.testing.assert_frame_equal(
        bent.tables["ranks"], study("straight", earth_rate=False).tables["ranks"]
    )


def test_neither_log_nor_scenario_is_an_error() -> None:
    with pytest.raises(ConfigError, match="strait: ") as caught:
        study_observability("strait", load_config("levy-klein"))
    assert "straight" in caught.value.hint


def test_span_without_a_whole_window_leaves_nothing_to_accelerations(tmp_path: Path) -> None:
    config = load_config(overrides=["span.start_s=10.0", "span.end_s=12.0"])
    report = study_observability("straight", config)
    assert ranks(report)["published"] == ranks(report)["windowed"] == 0
    save_result(report, tmp_path)
    assert (tmp_path / "singular_values.svg").stat().st_size > 0


def test_interrupted_command_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(studies, "save_result", interrupted)
    assert (
        run_command_line(["study", "observability", "straight", "-o", str(tmp_path / "study")])
        == 130
    )
    assert list(tmp_path.iterdir()) == []
