"""The page of a dive: all of it in one file, small, and honest about what is missing."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from taken_apart import Document

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import STATES
from insdvl_replay.core.table_layout import finite
from insdvl_replay.replay import Replay, replay_dive, replay_log
from insdvl_replay.report.document import Callout, DisplayTable, Heading, Html, Title, parts_for
from insdvl_replay.report.page import page
from insdvl_replay.report.terminal import for_terminal
from insdvl_replay.results.coverage import Source, covered_shares
from insdvl_replay.results.dive_document import dive_document
from insdvl_replay.results.dive_tables import glance_table
from insdvl_replay.results.filter_figures import Clock
from insdvl_replay.results.json_report import Report, decode_report
from insdvl_replay.results.reference_tables import NO_REFERENCE
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


def page_tables(report: Report) -> list[DisplayTable]:
    """The tables of a page behind the one that gives all at a glance."""
    return [part for part in parts_for("html", dive_document(report)) if isinstance(part, DisplayTable)]


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
    for table in page_tables(report):
        assert table.title in document.texts["h3"]
        for row in table.rows:
            assert set(row) <= {cell.strip() for cell in document.texts["td"]}
    assert document.texts["h2"] == [
        "Evidence", "Figures", "Tables", "What was lost or assumed", "Provenance"
    ]  # fmt: skip


def test_every_plot_is_there_with_a_line_for_each_filter(result: tuple[Document, Report, bytes]) -> None:
    document, _, _ = result
    titles = [attributes["aria-label"] for tag, attributes in document.elements if "aria-label" in attributes]
    assert [f"{state.label} [{state.unit}]" for state in STATES] == titles[14:26]
    assert titles[9:14] == [
        "horizontal drift [m]", "drift in 60 s, by where they begin [m]",
        "level: roll and pitch [deg]", "heading [deg]", "horizontal velocity [m/s]",
    ]  # fmt: skip
    assert len([title for title in titles if "position error" in title]) == 3
    assert [title for title in titles if "NIS" in title] == [
        "baseline: NIS of the velocity", "aided: NIS of the velocity", "aided: NIS of the acceleration",
    ]  # fmt: skip
    assert len(titles) == 9 + 2 + 3 + 12 + 3 + 4 + 3
    assert document.count("path", "line") > 2 * 12 + 2 * 9
    assert document.count("svg", "strip") == 7
    paths = [attributes["d"] for tag, attributes in document.elements if tag == "path"]
    assert all(len(path) > 5 for path in paths if path)


def test_believed_stands_beside_measured(result: tuple[Document, Report, bytes]) -> None:
    document, report, _ = result
    (bars,) = (text for text in document.texts["table"] if text.startswith("quantitybelievedmeasured"))
    measured = {row.quantity: row.ratio for row in report.tables.evidence if row.evidence in ("accuracy", "coasting")}
    believed = {row.state: row.improvement_pct for row in report.tables.improvement}
    level_pct, drift_pct = (100.0 * (1.0 - finite(measured[name])) for name in ("level", "drift_30s"))
    assert f"misalignment, north / level{believed['phi_n']:.1f} %{level_pct:.1f} %" in bars
    assert f"drift in 30 s-{drift_pct:.1f} %" in bars
    assert document.count("rect", "believed") == 1 + 12
    assert document.count("rect", "measured") == len(measured) + 1, "level stands beside two states"


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
    assert NO_REFERENCE in document.texts["p"]
    assert document.count("rect", "measured") == 0


@pytest.fixture(scope="module")
def alone() -> Replay:
    """A dive of which neither reference nor truth is known."""
    dive = replace(simulate_dive("figure-eight", seed=0, duration_s=230.0), reference=None, truth=None)
    return replay_dive(dive, load_config(overrides=[
        "initial.source=level", "initial.heading_deg=30", "initial.latitude_deg=32.8"
    ]))  # fmt: skip


def test_a_dive_without_a_reference_has_a_page_of_coasting_honesty_and_belief(alone: Replay, tmp_path: Path) -> None:
    document, report, data = saved(alone, tmp_path / "alone")
    titles = [attributes["aria-label"] for tag, attributes in document.elements if "aria-label" in attributes]
    assert titles[:2] == ["horizontal drift [m]", "drift in 60 s, by where they begin [m]"]
    assert not {title for title in titles if title.startswith(("position error", "level"))}
    assert data.decode().count(NO_REFERENCE) == 1
    assert data.decode().lower().count("no reference") == 1
    assert "no reference" not in report.filters["aided"].verdict
    (bars,) = (text for text in document.texts["table"] if text.startswith("quantitybelieved"))
    assert "drift in 30 s" not in bars
    assert "coasting 30 s" in bars
    assert "-" not in document.texts["td"][:5], "at a glance"
    assert document.texts["strong"][0] == "Believed against measured: how much smaller the errors are"
    assert report.tables.drift == report.tables.track_fit == []


def test_a_dive_without_a_reference_fits_a_terminal(alone: Replay, tmp_path: Path) -> None:
    _, report, _ = saved(alone, tmp_path / "screen")
    for width in (80, 10_000):
        console = Console(width=width, record=True, file=io.StringIO())
        console.print(for_terminal(dive_document(report)))
        lines = console.export_text().split("\n")
        assert max(len(line.rstrip()) for line in lines) <= width
        words = " ".join(" ".join(lines).split())
        assert words.count(NO_REFERENCE) == 1
        assert words.lower().count("no reference") == 1
        assert any(line.split()[:2] == ["filter", "for"] for line in lines), "no word is folded"
        assert "Reference error" not in words


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
