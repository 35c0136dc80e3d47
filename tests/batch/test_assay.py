"""Controls of `run --assay`: each plants its fault, of a size that is known, and nothing else."""

from typing import Any

import msgspec
import numpy as np
import pytest

from insdvl_replay.batch.assay import CONTROLS, assay_of
from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter, Initial, Noise
from insdvl_replay.core.dive_columns import NS_PER_S, Dive
from insdvl_replay.core.tables import AssayRow
from insdvl_replay.core.words import Role
from insdvl_replay.evaluation.answers import assay_rows, seen_controls
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

FOG = GRADES["fog"]
BEAM_SD_MPS = 0.004
CONFIG = Config(
    noise=Noise(
        accel_white_mps_rts=FOG.accel_white_mps_rts, gyro_white_rad_rts=FOG.gyro_white_rad_rts
    ),
    dvl=Dvl(
        lever_arm_m=(1.0, -0.2, 0.3), mounting_rpy_deg=(0.0, 0.0, 45.0), beam_sd_mps=BEAM_SD_MPS
    ),
    filters={"baseline": Filter(aiding=("velocity",)), "beams": Filter(aiding=("beams",))},
    initial=Initial(uncertainty="settings", misalignment_sd_deg=(0.02, 0.02, 0.02)),
    evaluation=Evaluation(starts=4),
)


def paths_of(settings: Any, before: str = "") -> dict[str, Any]:
    """Return all values of nested settings, by their dotted names."""
    if not isinstance(settings, dict):
        return {before: settings}
    found = {}
    for name, value in settings.items():
        found |= paths_of(value, f"{before}.{name}".lstrip("."))
    return found


@pytest.fixture(scope="module")
def dive() -> Dive:
    """A straight dive with quiet sensors, so that a planted fault is nearly all of the error."""
    quiet = DvlErrors(beam_sd_mps=BEAM_SD_MPS, beam_bias_sd_mps=0.0, beam_scale_sd=0.0)
    return simulate_dive(
        "straight", seed=5, duration_s=240.0, imu_rate_hz=25.0, dvl_rate_hz=2.0, grade="fog", dvl_errors=quiet,
        lever_arm_m=(1.0, -0.2, 0.3), mounting_rpy_deg=(0.0, 0.0, 45.0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def rows(dive: Dive) -> list[AssayRow]:
    return assay_of(dive, CONFIG)


@pytest.mark.parametrize(
    ("control", "key", "value"),
    [
        ("dvl_noise_x2", "filters.baseline.beam_sd_mps", 2.0 * BEAM_SD_MPS),
        ("gyro_noise_x3", "filters.baseline.gyro_white_rad_rts", 3.0 * FOG.gyro_white_rad_rts),
        ("lever_arm_5cm", "dvl.lever_arm_m", (1.05, -0.2, 0.3)),
        ("heading_half_deg", "dvl.mounting_rpy_deg", (0.0, 0.0, 45.5)),
        ("dvl_scale_half_pct", "dvl.scale", 1.005),
    ],
)
def test_a_control_changes_one_setting(control: str, key: str, value: Any, dive: Dive) -> None:
    same, config = CONTROLS[control](dive, CONFIG)
    assert same is dive
    before, after = (paths_of(msgspec.to_builtins(settings)) for settings in (CONFIG, config))
    assert [name for name in after if after[name] != before[name]] == [key]
    assert after[key] == pytest.approx(value)


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({"beam_sd_mps": 0.01}, "beam_sd_mps"),
        ({"velocity_sd_mps": 0.01}, "velocity_sd_mps"),
    ],
)
def test_noise_that_the_baseline_has_of_its_own_is_what_is_doubled(
    given: dict[str, float], key: str, dive: Dive
) -> None:
    own = Filter(aiding=("velocity",), gyro_white_rad_rts=1e-6, **given)
    config = msgspec.structs.replace(CONFIG, filters={"baseline": own})
    _, doubled = CONTROLS["dvl_noise_x2"](dive, config)
    assert getattr(doubled.filters["baseline"], key) == 0.02
    _, noisy = CONTROLS["gyro_noise_x3"](dive, config)
    assert noisy.filters["baseline"].gyro_white_rad_rts == pytest.approx(3e-6)


def test_pings_of_the_control_with_a_delay_count_as_earlier(dive: Dive) -> None:
    """The latency of the settings is in the times of a dive already, so that a change of it would do nothing."""
    delayed, config = CONTROLS["delay_50ms"](dive, CONFIG)
    assert config == CONFIG
    np.testing.assert_array_equal(dive.dvl.time_ns - delayed.dvl.time_ns, NS_PER_S // 20)
    np.testing.assert_array_equal(delayed.dvl.beam_velocity_mps, dive.dvl.beam_velocity_mps)
    np.testing.assert_array_equal(delayed.imu.time_ns, dive.imu.time_ns)


@pytest.mark.nightly
def test_every_control_does_something_to_the_errors(rows: list[AssayRow]) -> None:
    assert list(dict.fromkeys(row.filter for row in rows)) == list(CONTROLS)
    for control in CONTROLS:
        ratios = [row.ratio for row in rows if row.filter == control and row.ratio is not None]
        assert max(abs(ratio - 1.0) for ratio in ratios) > 1e-4, control


@pytest.mark.parametrize(
    ("control", "of_way"),
    [("heading_half_deg", np.sin(np.deg2rad(0.5))), ("dvl_scale_half_pct", 0.005)],
)
def test_faults_of_the_dvl_drift_by_their_share_of_the_way(
    control: str, of_way: float, rows: list[AssayRow]
) -> None:
    """Over 100 m on a straight course, but for the drift that the baseline has without them: they add as vectors."""
    [row] = [row for row in rows if (row.filter, row.quantity) == (control, "drift_100m")]
    assert row.baseline is not None
    assert row.value is not None
    assert row.baseline < 0.2
    assert abs(row.value - 100.0 * of_way) < 1.1 * row.baseline
    assert row.ratio == pytest.approx(row.value / row.baseline)


def test_baseline_is_the_same_beside_each_control_and_may_decide(rows: list[AssayRow]) -> None:
    for quantity in {row.quantity for row in rows}:
        assert len({row.baseline for row in rows if row.quantity == quantity}) == 1
    assert {row.role for row in rows if row.quantity == "position"} == {Role.PRIMARY}


def of_dives(ratios: dict[str, list[float]]) -> list[list[AssayRow]]:
    """Return rows on three dives or more, by control."""
    return [
        [
            AssayRow(
                f"dive {place}",
                control,
                "position",
                "m",
                1.0,
                values[place],
                values[place],
                Role.PRIMARY,
            )
            for control, values in ratios.items()
        ]
        for place in range(len(next(iter(ratios.values()))))
    ]


def test_a_control_is_seen_where_its_fault_is_large() -> None:
    """On several dives by the rule of any candidate: the first changes every dive, the last none surely."""
    dives = of_dives(
        {
            "large": [3.0, 3.2, 2.9, 3.1],
            "small": [1.01, 1.0, 1.02, 1.0],
            "loose": [3.0, 0.4, 1.0, 2.0],
        }
    )
    assert seen_controls(assay_rows(dives, "position")) == (["large"], ["small", "loose"])
