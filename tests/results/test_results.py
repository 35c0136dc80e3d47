"""A result folder: the same bytes from run to run, and a replay.mcap that other people's tools read in full."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.quantities import SETTLED
from insdvl_replay.preparation.replay import replay_log
from insdvl_replay.results.folder import DIVE_FILES
from insdvl_replay.show.result_files import save_replay

SAMPLE = Path(__file__).parents[2] / "sample_logs" / "figure_eight.mcap"
FILES = {
    "improvement.csv", "convergence.csv", "reference_error.csv", "consistency.csv",
    "credibility.csv", "evidence.csv", "outage.csv", "drift.csv", "track_fit.csv", "jumps.csv", "assay.csv",
    "where.csv",
    "report.json", "report.html", "replay.mcap", "foxglove.json", "plotjuggler.xml", "trajectory.npz",
    "config.toml", "run.log",
}  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same log replayed twice."""
    folders = tmp_path_factory.mktemp("once"), tmp_path_factory.mktemp("again")
    for folder in folders:
        save_replay(replay_log(SAMPLE, load_config("levy-klein")), folder)
    return folders


def test_folder_holds_the_files_of_the_contract(results: tuple[Path, Path]) -> None:
    assert {path.name for path in results[0].iterdir()} == FILES == set(DIVE_FILES)


@pytest.mark.parametrize("name", sorted(FILES))
def test_same_log_gives_the_same_bytes(results: tuple[Path, Path], name: str) -> None:
    once, again = ((folder / name).read_bytes() for folder in results)
    if name == "report.json":
        reports = [json.loads(data) for data in (once, again)]
        for report in reports:
            report.pop("tool")
        assert reports[0] == reports[1]
    else:
        assert once == again


def test_saved_configuration_gives_the_same_result(
    results: tuple[Path, Path], tmp_path: Path
) -> None:
    config = load_config(preset="mems", file=results[0] / "config.toml")
    save_replay(replay_log(SAMPLE, config), tmp_path)
    assert (tmp_path / "improvement.csv").read_bytes() == (
        results[0] / "improvement.csv"
    ).read_bytes()
    assert (tmp_path / "config.toml").read_bytes() == (results[0] / "config.toml").read_bytes()


def test_mcap_ros2_support_reads_every_message_of_the_replay(results: tuple[Path, Path]) -> None:
    counts: Counter[str] = Counter()
    ba_z_mg: dict[int, float] = {}
    ping_ns: list[int] = []
    with (results[0] / "replay.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        for _, channel, message, decoded in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            if channel.topic == "/insdvl/dvl/velocity":
                ping_ns.append(message.log_time)
            if channel.topic == "/insdvl/aided/sigma":
                ba_z_mg[message.log_time] = decoded.ba_z_mg
    assert summary.statistics is not None
    assert sum(counts.values()) == summary.statistics.message_count
    expected = {
        "/insdvl/baseline/innovation/velocity": 394,
        "/insdvl/aided/innovation/velocity": 394,
        "/insdvl/aided/innovation/acceleration": 392,
        "/insdvl/dvl/velocity": 394,
        "/insdvl/dvl/acceleration": 392,
        "/insdvl/table/improvement": 12,
        "/insdvl/table/convergence": 12,
        "/insdvl/table/reference_error": 9,
        "/insdvl/table/consistency": 3 * 4,
        "/insdvl/table/credibility": 2 * (12 + 4 + 1) + len(SETTLED),
    }
    assert {topic: counts[topic] for topic in expected} == expected
    for name in ("baseline", "aided"):
        for part in ("state", "sigma", "error", "odometry", "fix"):
            assert counts[f"/insdvl/{name}/{part}"] > 390
    table = pd.read_csv(results[0] / "improvement.csv").set_index("state")
    assert ba_z_mg[max(ping_ns)] == table.loc["ba_z", "sd"]


def test_rosbags_reads_every_message_of_the_replay(results: tuple[Path, Path]) -> None:
    with AnyReader([results[0] / "replay.mcap"]) as reader:
        seen = Counter(
            connection.topic
            for connection, _, data in reader.messages()
            if reader.deserialize(data, connection.msgtype) is not None
        )
        assert seen == {connection.topic: connection.msgcount for connection in reader.connections}
    assert sum(seen.values()) > 10_000


def test_csv_has_full_precision_and_the_contracts_columns(results: tuple[Path, Path]) -> None:
    table = pd.read_csv(results[0] / "improvement.csv")
    assert list(table.columns) == [
        "log", "filter", "state", "unit", "baseline_sd", "sd", "improvement_pct", "status",
    ]  # fmt: skip
    change = 100.0 * (table["baseline_sd"] - table["sd"]) / table["baseline_sd"]
    np.testing.assert_allclose(table["improvement_pct"], change, rtol=1e-12)
