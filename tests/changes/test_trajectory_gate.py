"""Gates on the trajectory: the least change of a filter is found with quantity and time, rounding is not."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processors import PROCESSORS

from insdvl_replay.changes.gate_file import TrajectoryGate, load_gates
from insdvl_replay.changes.trajectory_gates import trajectory_findings
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.states import COLUMNS, GROUPS
from insdvl_replay.results.trajectory import Trajectory, read_trajectory, write_trajectory

DIVES = Path(__file__).parents[2] / "examples" / "archive" / "dives"
GATE = """
[[gate]]
name = "nothing changes"
table = "trajectory"
expected = "expected/{log}.npz"
"""
EXPECTED = TrajectoryGate(name="nothing changes", table="trajectory", expected="{log}.npz")


def made(samples: int = 400) -> Trajectory:
    """A baseline and a candidate that go straight ahead at 2 m/s, with slow sines in all else."""
    time_s = np.arange(float(samples))
    values = np.stack(
        [
            np.stack([np.sin(0.01 * time_s + place) + filter_ for place in range(len(COLUMNS))], 1)
            for filter_ in (1, 2)
        ]
    )
    values[:, :, COLUMNS.index("position_n_m")] = 2.0 * time_s
    return Trajectory("ab" * 32, ("baseline", "aided"), time_s, values)


def changed(filter_: int, column: str, samples: slice, by: float) -> Trajectory:
    trajectory = made()
    values = trajectory.values.copy()
    values[filter_, samples, COLUMNS.index(column)] += by
    return replace(trajectory, values=values)


def sentences(gate: TrajectoryGate, new: Trajectory, old: Trajectory | None = None) -> list[str]:
    return [
        finding.sentence
        for finding in trajectory_findings(gate, new, old or made())
        if not finding.passed
    ]


def trajectories(told: str) -> list[int]:
    """Return how many trajectories changed, did not change and could not be compared."""
    (line,) = re.findall(r"^trajectories: .*", told, re.MULTILINE)
    return [int(number) for number in re.findall(r"\d+", line)]


def test_the_first_sample_that_differs_is_reported_with_its_quantity() -> None:
    new = changed(0, "heading_deg", slice(132, 400), 3.1e-4)
    values = new.values.copy()
    values[0, 200:, COLUMNS.index("velocity_n_mps")] += 1.0
    [told] = sentences(EXPECTED, replace(new, values=values))
    assert told.startswith("baseline: heading_deg ")
    assert re.findall(r"\b\d[\d.e-]*", told) == ["132", "0.00031", "2e-09", "268", "400", "1"]


def test_rounding_is_no_change_and_a_little_more_is() -> None:
    """The position reaches 798 m, so that a billionth of it are 0.8 micrometres."""
    assert sentences(EXPECTED, changed(1, "position_e_m", slice(10, 20), 0.7e-6)) == []
    assert len(sentences(EXPECTED, changed(1, "position_e_m", slice(10, 20), 0.9e-6))) == 1


def test_a_column_may_have_an_allowance_of_its_own() -> None:
    new = changed(1, "position_e_m", slice(10, 20), 1e-3)
    gate = TrajectoryGate(
        name="g", table="trajectory", expected="b", max_abs={"position_e_m": 2e-3}
    )
    assert sentences(gate, new) == []
    assert (
        sentences(TrajectoryGate(name="g", table="trajectory", expected="b", max_rel=1e-5), new)
        == []
    )
    assert (
        sentences(TrajectoryGate(name="g", table="trajectory", expected="b", row="velocity"), new)
        == []
    )


def test_headings_on_both_sides_of_the_seam_are_near() -> None:
    old = changed(0, "heading_deg", slice(0, 400), 180.0)
    values = old.values.copy()
    values[0, :, COLUMNS.index("heading_deg")] -= 360.0
    assert sentences(EXPECTED, replace(old, values=values), old) == []


def test_what_is_missing_on_both_sides_is_the_same_and_on_one_it_differs() -> None:
    missing = changed(0, "position_error_m", slice(0, 50), np.nan)
    assert sentences(EXPECTED, missing, missing) == []
    [told] = sentences(EXPECTED, missing)
    assert re.search(r"position_error_m .* 0 s \(by inf, .*\b50 of 400 ", told)


def test_filters_and_times_that_are_not_the_same_never_pass() -> None:
    new, old = made(), made()
    one = replace(old, names=("baseline",), values=old.values[:1])
    assert [told.split(":")[0] for told in sentences(EXPECTED, new, one)] == ["aided"]
    assert [told.split(":")[0] for told in sentences(EXPECTED, one, new)] == ["aided"]
    [first, _] = sentences(EXPECTED, made(399), old)
    assert re.fullmatch(r"baseline: .*399 .* 400 .*", first)
    assert sentences(EXPECTED, made()) == []
    gone = trajectory_findings(EXPECTED, None, made())
    assert [finding.passed for finding in gone] == [False]


def over_time(**keys: float) -> TrajectoryGate:
    names = {"name": "g", "table": "trajectory", "filter": "aided", "row": "position_error_m"}
    return TrajectoryGate(within=(0.0, 3.5), **names, **keys)  # type: ignore[arg-type]


def test_share_of_the_time_and_longest_stay_outside() -> None:
    """Of 400 samples 30 are outside: 20 in a row from 100 s, and 10 from 300 s."""
    new = changed(1, "position_error_m", slice(100, 120), 50.0)
    values = new.values.copy()
    values[1, 300:310, COLUMNS.index("position_error_m")] = np.nan
    new = replace(new, values=values)
    assert sentences(over_time(share_pct=92.5), new) == []
    [told] = sentences(over_time(share_pct=93.0), new)
    assert re.search(r"92\.5 % of 400 .* 93 %", told)
    assert sentences(over_time(longest_outside_s=20.0), new) == []
    [told] = sentences(over_time(longest_outside_s=19.0), new)
    assert re.findall(r"(\d+) s\b", told) == ["20", "100", "19"]
    assert len(sentences(over_time(), new)) == 1, "without a share all samples are meant"


def test_a_value_at_one_time() -> None:
    new = changed(1, "position_error_m", slice(100, 120), 50.0)
    assert sentences(over_time(at_s=99.0), new) == []
    [told] = sentences(over_time(at_s=100.0), new)
    assert "at 100 s" in told
    [told] = sentences(over_time(at_s=1000.0), new)
    assert told.endswith(" 1000 s")
    assert sentences(over_time(at_s=400.0), new) == [], (
        "one second after the last sample is near enough"
    )
    assert len(sentences(over_time(at_s=400.1), new)) == 1


def test_a_trajectory_is_read_back_to_the_bit_and_is_the_same_bytes(tmp_path: Path) -> None:
    for name in ("once", "again"):
        write_trajectory(tmp_path / name, made())
    assert (tmp_path / "once").read_bytes() == (tmp_path / "again").read_bytes()
    found = read_trajectory(tmp_path / "once")
    assert found is not None
    assert (found.sha256, found.names) == (made().sha256, made().names)
    np.testing.assert_array_equal(found.values, made().values)
    for broken in (b"", b"PK", (tmp_path / "once").read_bytes()[:200]):
        (tmp_path / "broken").write_bytes(broken)
        assert read_trajectory(tmp_path / "broken") is None
    assert read_trajectory(tmp_path / "absent") is None


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ('row = "heading"\nexpected = "b.npz"', "row 'heading'"),
        ('column = "rmse"\nexpected = "b.npz"', "key 'column'"),
        ("", "share_pct"),
        ('row = "attitude"\nwithin = [0, 1]', "row 'attitude'"),
        ('row = "position_error_m"\nwithin = [1, 0]', "within = [1.0, 0.0]"),
        ('row = "position_error_m"\nwithin = [0, 1]\nexpected = "b.npz"', "within"),
        ('expected = "b.npz"\nmax_abs = { heading = 1 }', "max_abs 'heading'"),
    ],
)
def test_keys_that_do_not_go_together_are_reported_before_any_replay(
    keys: str, named: str, tmp_path: Path
) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(f'[[gate]]\nname = "g"\ntable = "trajectory"\n{keys}\n')
    with pytest.raises(ConfigError) as found:
        load_gates(path)
    assert named in f"{found.value.message}; {found.value.hint}"


def test_every_column_has_a_group() -> None:
    assert len(COLUMNS) == len(set(COLUMNS)) == sum(map(len, GROUPS.values())) == 34


@pytest.fixture
def team(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Two dives whose trajectories are stored, and the command that checks them."""
    (tmp_path / "dives").mkdir()
    for name in ("transit", "outage"):
        shutil.copy(DIVES / f"{name}.mcap", tmp_path / "dives")
    (tmp_path / "gates.toml").write_text(f'dives = ["dives/*.mcap"]\n{GATE}', "utf-8")
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["check", "gates.toml", "--update"]) == 0

    def check(*options: str) -> int:
        return run_command_line(["check", "gates.toml", *options])

    return check


@pytest.mark.parametrize(
    "constant",
    [
        "noise.gyro_white_rad_rts=3.7000037e-5",
        pytest.param("noise.accel_white_mps_rts=0.2000002", marks=pytest.mark.nightly),
        pytest.param("dvl.velocity_sd_mps=0.02000002", marks=pytest.mark.nightly),
        pytest.param("dvl.scale=1.000001", marks=pytest.mark.nightly),
        pytest.param("initial.accel_bias_sd_mg=50.00005", marks=pytest.mark.nightly),
    ],
)
def test_a_millionth_of_one_constant_is_caught_with_quantity_and_time(
    constant: str, team: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert team("--rerun") == 0
    assert trajectories(capsys.readouterr().out) == [0, 2, 0]
    assert team("--set", constant) == 1
    told = capsys.readouterr().out
    assert len(re.findall(r"_\w+ .* \d+ s \(", told)) >= 2
    assert trajectories(told) == [2, 0, 0]


@pytest.mark.nightly
@pytest.mark.parametrize("name", PROCESSORS)
def test_another_processor_passes(
    name: str, team: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    """Its libraries round the last bits differently."""
    capsys.readouterr()
    PROCESSORS[name].run(["check", "gates.toml", "--results", name])
    assert team("--results", "here") == 0
    there, here = (
        read_trajectory(Path(folder) / "transit" / "trajectory.npz") for folder in (name, "here")
    )
    assert there is not None
    assert here is not None
    assert there.values.shape == here.values.shape


def test_broken_expected_values_are_an_error_of_that_dive(
    team: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("expected/outage.npz").write_bytes(b"PK")
    assert team() == 1
    told = capsys.readouterr().out
    assert "expected/outage.npz: " in told
    assert trajectories(told) == [0, 1, 1]
