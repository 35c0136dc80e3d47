"""The page of a dive: all of it in one file, small, and honest about what is missing."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from taken_apart import Document

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import STATES
from insdvl_replay.replay import Replay, replay_dive, replay_log
from insdvl_replay.report.document import Callout, DisplayTable, Heading, Html, Title
from insdvl_replay.report.page import page
from insdvl_replay.results.coverage import Source, covered_shares
from insdvl_replay.results.dive_tables import display_tables, glance_table
from insdvl_replay.results.filter_figures import Clock
from insdvl_replay.results.json_report import Report, decode_report
from insdvl_replay.results.result_files import save_replay
from insdvl_replay.sim.dive import simulate_dive

SAMPLE = Path(__file__).parents[2] / "sample_logs" / "figure_eight.mcap"
S = 1_000_000_000


def saved(replay: Replay, folder: Path) -> tuple[Document, Report, bytes]:
    """The page of a replay, the report that it is to show, and its bytes."""
    folder.mkdir()
    save_replay(replay, folder)
    data = (folder / "report.html").read_bytes()
    return Document(data.decode()), decode_report((folder / "report.json").read_bytes()), data


@pytest.fixture(scope="module")
def replay() -> Replay:
    return replay_log(SAMPLE, load_config())


@pytest.fixture(scope="module")
def result(replay: Replay, tmp_path_factory: pytest.TempPathFactory) -> tuple[Document, Report, bytes]:
    return saved(replay, tmp_path_factory.mktemp("html") / "result")


def test_verdict_comes_first_and_every_cell_of_every_table_is_there(result: tuple[Document, Report, bytes]) -> None:
    document, report, _ = result
    assert document.texts["p"][0] == report.filters["aided"].verdict
    assert tuple(document.texts["td"][:7]) == glance_table(report).rows[0]
    for table in display_tables(report):
        assert table.title in document.texts["h3"]
        for row in table.rows:
            assert set(row) <= {cell.strip() for cell in document.texts["td"]}
    assert document.texts["h2"] == [
        "Tables", "Figures", "What was lost or assumed", "Provenance"
    ]  # fmt: skip


def test_every_plot_is_there_with_a_line_for_each_filter(result: tuple[Document, Report, bytes]) -> None:
    document, _, _ = result
    titles = [attributes["aria-label"] for tag, attributes in document.elements if "aria-label" in attributes]
    assert [f"{state.label} [{state.unit}]" for state in STATES] == titles[:12]
    assert len([title for title in titles if "position error" in title]) == 3
    assert [title for title in titles if "NIS" in title] == [
        "baseline: NIS of the velocity", "aided: NIS of the velocity", "aided: NIS of the acceleration",
    ]  # fmt: skip
    assert len(titles) == 12 + 9 + 3 + 4 + 3
    assert document.count("path", "line") > 2 * 12 + 2 * 9
    assert document.count("svg", "strip") == 7
    paths = [attributes["d"] for tag, attributes in document.elements if tag == "path"]
    assert all(len(path) > 5 for path in paths if path)


def test_believed_stands_beside_actual(result: tuple[Document, Report, bytes]) -> None:
    document, report, _ = result
    bars = document.texts["table"][1 + len(display_tables(report))]
    aided = report.filters["aided"]
    assert f"{aided.mean_improvement_pct:.1f} %{aided.reference_improvement_pct:.1f} %" in bars
    assert document.count("rect", "believed") == 1 + 12
    assert document.count("rect", "actual") == 1 + 9


def test_page_names_its_origin(result: tuple[Document, Report, bytes]) -> None:
    document, report, _ = result
    facts = document.texts["dd"]
    assert report.log.sha256 in facts
    assert f"insdvl-replay {report.tool.version}" in facts
    assert "[filters.aided]" in document.texts["pre"][0]
    assert {channel.topic for channel in report.log.channels} <= set(document.texts["td"])


def test_page_asks_nobody_for_anything(result: tuple[Document, Report, bytes]) -> None:
    document, _, data = result
    assert not {"script", "link", "img", "iframe", "object"} & {tag for tag, _ in document.elements}
    assert not re.search(rb"https?://|url\(|@import", data)
    [policy] = [attributes["content"] for _, attributes in document.elements if "http-equiv" in attributes]
    assert policy.startswith("default-src 'none'")


def test_identifiers_are_unique(result: tuple[Document, Report, bytes]) -> None:
    ids = [attributes["id"] for _, attributes in result[0].elements if "id" in attributes]
    assert len(ids) == len(set(ids)) > 0


def test_notes_are_told_with_their_counts(replay: Replay, tmp_path: Path) -> None:
    note = Note("imu_gaps", "the IMU <pauses> 3 times", 4711, "warning", "imu.max_gap_s=2")
    document, _, _ = saved(replace(replay, notes=(note,)), tmp_path / "notes")
    cells = document.texts["td"]
    assert {"4711", "warning", "the IMU <pauses> 3 times [imu_gaps]", "imu.max_gap_s=2"} <= set(cells)


def test_four_filters_without_a_reference_and_a_dive_without_accelerations(tmp_path: Path) -> None:
    dive = replace(simulate_dive("straight", seed=2, duration_s=60.0), reference=None, truth=None)
    settings = ["initial.source=level", "initial.heading_deg=30", "initial.latitude_deg=32.8"]
    settings += [f"filters.{name}.aiding=['velocity']" for name in ("baseline", "aided", "third", "fourth <&>")]
    settings += ["filters.third.velocity_sd_mps=0.05"]
    replay = replay_dive(dive, load_config(overrides=[text for text in settings if "<" not in text]))
    document, report, _ = saved(replay, tmp_path / "four")
    assert list(report.filters) == ["aided", "third"]
    titles = [attributes["aria-label"] for tag, attributes in document.elements if "aria-label" in attributes]
    assert len(titles) == 12 + 3 + 4
    assert "no reference" in document.texts["p"]
    assert document.count("rect", "actual") == 0


@pytest.mark.slow
def test_a_long_dive_stays_small_and_shows_its_outage(tmp_path: Path) -> None:
    """Three hours, many times as many samples as a panel has columns: more make the page no larger."""
    dive = simulate_dive("lawnmower", seed=3, duration_s=3 * 3600.0, outages=[(6000.0, 6600.0)])
    _, _, data = saved(replay_dive(dive, load_config()), tmp_path / "long")
    assert len(data) < 500_000
    assert b"time [h]" in data
    assert b"94.4 %" in data


def test_a_short_dive_stays_small(result: tuple[Document, Report, bytes]) -> None:
    assert len(result[2]) < 1_500_000


def test_time_axis_has_a_unit_that_suits_the_dive() -> None:
    labels = {length_s: Clock(0, length_s * S).label for length_s in (424, 1500, 9 * 3600)}
    assert labels == {424: "time [s]", 1500: "time [min]", 9 * 3600: "time [h]"}
    np.testing.assert_allclose(Clock(S, 9 * 3600 * S).time(np.array([S, 1801 * S])), [0.0, 0.5])


def test_coverage_falls_where_samples_are_missing_or_invalid() -> None:
    time_ns = np.concatenate([np.arange(0, 40), np.arange(60, 101)]) * S
    valid = (time_ns < 80 * S) | (time_ns >= 90 * S)
    shares = covered_shares(Source("DVL", time_ns, valid), 0, 100 * S, 10)
    np.testing.assert_allclose(shares, [1, 1, 1, 1, 0.15, 0, 1, 1, 0, 1], atol=1e-12)


@pytest.mark.parametrize("samples", [0, 1])
def test_coverage_of_a_silent_sensor_is_nothing(samples: int) -> None:
    silent = Source("DVL", np.arange(samples), np.ones(samples, dtype=bool))
    assert covered_shares(silent, 0, S, 4).tolist() == [0.0] * 4


def test_any_text_is_text() -> None:
    table = DisplayTable("<t>", ("a\nb", "&"), "lr", (("<script>", "1"), ('"', "2")), "<f>")
    document = Document(
        page([Title("<h>"), "<p>", Callout("<l>"), Heading("Über & <all>"), table, Html("<em>x</em>")]).decode()
    )
    assert document.texts["h1"] == ["<h>"]
    assert document.texts["td"] == ["<script>", "1", '"', "2"]
    assert document.texts["em"] == ["x"]
    assert "script" not in document.texts
    assert "#" + next(attributes["id"] for _, attributes in document.elements if "id" in attributes) in {
        attributes.get("href") for _, attributes in document.elements
    }
