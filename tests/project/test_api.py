"""A function for every command: what it returns has tables as data frames, a screen, and can be saved."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import insdvl_replay
from insdvl_replay import CommandResult, load_config, read_results, replay_log
from insdvl_replay.core.errors import ConfigError, UserError

ARCHIVE = Path(__file__).resolve().parents[2] / "examples" / "archive"
FAST = load_config(settings={"evaluation.starts": 1})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two dives."""
    place = tmp_path_factory.mktemp("api")
    for name in ("transit", "outage"):
        replay_log(ARCHIVE / "dives" / f"{name}.mcap", FAST).save(place / name)
    return place


def is_whole(result: CommandResult, tables: set[str], place: Path) -> None:
    """Check what every result can do."""
    assert set(result.tables) == tables
    assert all(isinstance(frame, pd.DataFrame) for frame in result.tables.values())
    assert len(str(result).splitlines()) > 2
    assert result._repr_html_().startswith("<div>")
    saved = result.save(place)
    assert {"report.html", "report.json", *(f"{name}.csv" for name in tables)} <= {
        path.name for path in saved.iterdir()
    }
    with pytest.raises(UserError, match="exists"):
        result.save(place)
    with pytest.raises(UserError, match="'nowhere'"):
        _ = result.tables["nowhere"]


def test_inspect(tmp_path: Path) -> None:
    found = insdvl_replay.inspect(ARCHIVE / "dives" / "transit.mcap", deep=True)
    is_whole(
        found,
        {"file", "topics", "roles", "clocks", "pings", "reference", "notes"},
        tmp_path / "saved",
    )
    assert set(found.tables["roles"]["role"]) >= {"imu", "dvl", "reference"}


def test_propose_and_calibrate_find_settings(tmp_path: Path) -> None:
    log = insdvl_replay.simulate(
        "calibration", tmp_path / "dive.mcap", duration_s=60.0, lever_arm_m=(0.5, 0.0, 0.0)
    )
    with pytest.raises(UserError, match="exists"):
        insdvl_replay.simulate("static", log)
    proposed = insdvl_replay.propose(log)
    is_whole(proposed, {"missing"}, tmp_path / "proposed")
    load_config(tmp_path / "proposed" / "proposed.toml")
    found = insdvl_replay.calibrate([log], load_config(), only=["arm"])
    is_whole(found, {"parameters", "noise", "dives"}, tmp_path / "calibrated")
    (tmp_path / "found.toml").write_text(found.settings)
    arm = load_config(tmp_path / "found.toml").dvl.lever_arm_m
    assert arm[0] == pytest.approx(0.5, abs=0.05)


def test_settings_are_compared(tmp_path: Path) -> None:
    after = load_config(settings={"evaluation.starts": 1, "dvl.scale": 1.05})
    found = insdvl_replay.compare_settings(
        ARCHIVE / "dives" / "transit.mcap", FAST, after, tmp_path / "out"
    )
    is_whole(
        found,
        {"answer", "where", "difference", "dive", "aggregate", "change"},
        tmp_path / "compared",
    )
    scale = found.tables["difference"].query("key == 'dvl.scale'")
    assert scale[["old", "new"]].to_numpy().tolist() == [["1.0", "1.05"]]
    with pytest.raises(UserError, match=r"transit: .*dvl\.scale 1\.0 -> 1\.05\n"):
        insdvl_replay.compare_settings(
            ARCHIVE / "dives" / "transit.mcap", after, FAST, tmp_path / "out"
        )


def test_compare_and_check(folder: Path, tmp_path: Path) -> None:
    changed = insdvl_replay.compare(folder / "transit", folder / "transit")
    is_whole(
        changed,
        {"answer", "where", "difference", "dive", "aggregate", "change"},
        tmp_path / "compared",
    )
    assert changed.tables["dive"]["log"].tolist() == ["transit"]
    gates = tmp_path / "gates.toml"
    gates.write_text(
        '[[gate]]\nname = "fast"\ntable = "outage"\ncolumn = "drift_median_m"\nmax = 1e9\n'
        '[[gate]]\nname = "good"\ntable = "drift"\ncolumn = "rms"\nmax = 0\n'
    )
    checked = insdvl_replay.check(gates, folder)
    is_whole(checked, {"gates"}, tmp_path / "checked")
    assert set(checked.tables["gates"]["gate"]) == {"fast", "good"}
    assert set(checked.tables["gates"].query("gate == 'good'")["status"]) == {"failed"}
    again = insdvl_replay.check(
        gates, ARCHIVE / "dives" / "transit.mcap", FAST, results=tmp_path / "results"
    )
    assert set(again.tables["gates"]["dive"]) == {"transit"}


def test_many_dives_have_pooled_evidence(folder: Path, tmp_path: Path) -> None:
    results = read_results(folder)
    assert list(results.dives) == ["outage", "transit"]
    assert results.words == {"aided": "undecided"}
    tables = results.tables
    assert set(tables["evidence"]["log"]) == {"outage", "transit"}
    assert len(tables["evidence"]) == sum(
        len(dive.tables["evidence"]) for dive in results.dives.values()
    )
    assert (tables["pooled"]["log"] == "*").all()
    assert tables["summary"]["log"].tolist() == ["outage", "transit"]
    assert results.dives["transit"].reference["position_n_m"].notna().all()
    assert "transit" in str(results)
    assert results._repr_html_().count("<td>") > 10
    is_whole(results, set(tables), tmp_path / "all")
    with pytest.raises(UserError, match="holds only results of studies"):
        read_results(tmp_path)


def test_settings_may_be_given_as_files(tmp_path: Path) -> None:
    (tmp_path / "vehicle.toml").write_text("[dvl]\nlever_arm_m = [300, 0, 0]\n")
    with pytest.raises(ConfigError) as refusal:
        replay_log(ARCHIVE / "dives" / "transit.mcap", str(tmp_path / "vehicle.toml"))
    assert refusal.value.where == (str(tmp_path / "vehicle.toml"),)


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda log, _: replay_log(log, {"dvl.scale": 1.0}), "config"),
        (lambda *_: replay_log(FAST), "log"),
        (lambda *_: insdvl_replay.inspect(None), "log"),
        (lambda log, _: insdvl_replay.calibrate([log, FAST]), "logs"),
        (lambda *_: load_config(FAST), "files"),
        (lambda *_: read_results(3), "folder"),
        (lambda *_: insdvl_replay.check(FAST), "gates"),
        (lambda log, folder: insdvl_replay.compare_settings(log, FAST, 3, folder), "after"),
        (
            lambda _, folder: insdvl_replay.compare(
                insdvl_replay.read_result(folder / "transit"), folder
            ),
            "old",
        ),
    ],
)
def test_an_argument_of_another_kind_is_named(
    call: Callable[..., Any], argument: str, folder: Path
) -> None:
    with pytest.raises(TypeError) as refusal:
        call(ARCHIVE / "dives" / "transit.mcap", folder)
    assert isinstance(refusal.value, UserError)
    assert refusal.value.what.startswith(f"{argument}: is not ")
    assert refusal.value.hint


@pytest.mark.parametrize(
    "call",
    [
        replay_log,
        insdvl_replay.inspect,
        insdvl_replay.propose,
        insdvl_replay.calibrate,
        lambda logs: insdvl_replay.compare_settings(logs, FAST, load_config(), "nowhere"),
    ],
)
def test_no_log_is_an_error_of_the_user(call: Callable[[list[Path]], Any]) -> None:
    with pytest.raises(ConfigError, match="names no dive"):
        call([])


@pytest.mark.parametrize("name", ["transit", "transit/report.json", "vehicle.toml"])
def test_a_result_or_settings_are_no_log_and_a_log_is_no_result(name: str, folder: Path) -> None:
    for call in (
        replay_log,
        insdvl_replay.inspect,
        insdvl_replay.propose,
        insdvl_replay.calibrate,
    ):
        with pytest.raises(ConfigError, match="not a log"):
            call(folder / name)
    with pytest.raises(ConfigError, match="not a result"):
        insdvl_replay.compare(ARCHIVE / "dives" / "transit.mcap", folder)
