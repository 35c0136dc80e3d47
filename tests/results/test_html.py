"""The page of a dive: all of it in one file, small, and honest about what is missing."""

import io
import re
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rich.console import Console
from taken_apart import Document, forest_rows

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.report import Report, decode_report
from insdvl_replay.core.states import STATES
from insdvl_replay.core.tables import finite
from insdvl_replay.document.page import page
from insdvl_replay.document.parts import (
    Callout,
    DisplayTable,
    Heading,
    Html,
    Title,
)
from insdvl_replay.document.tables import parts_for
from insdvl_replay.document.text import for_terminal
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.show.dive import NO_REFERENCE, changed_settings, dive_document
from insdvl_replay.show.plots.all_plots import error_panel, replay_figures
from insdvl_replay.show.plots.coverage import covered_shares
from insdvl_replay.show.plots.motion import error_vectors_panel, track_panel
from insdvl_replay.show.plots.shades import shades_of
from insdvl_replay.show.result_files import save_replay
from insdvl_replay.sim.dive import simulate_dive

pytestmark = pytest.mark.all_starts

SAMPLE = Path(__file__).parents[2] / "sample_logs" / "figure_eight.mcap"
DVL_NOISE = "dvl.velocity_sd_mps=0.005"  # of simulated pings: with noise that does not fit nothing is evaluated
S = 1_000_000_000


def saved(replay: Replay, folder: Path) -> tuple[Document, Report, bytes]:
    """The page of a replay, the report that it is to show, and its bytes."""
    folder.mkdir()
    save_replay(replay, folder)
    data = (folder / "report.html").read_bytes()
    return Document(data.decode()), decode_report((folder / "report.json").read_bytes()), data


def pictures(document: Document) -> tuple[list[str], list[str]]:
    """Titles of the panels on the first screen, but for the folded one, and of the others."""
    titles = [
        attributes["aria-label"]
        for tag, attributes in document.elements
        if "aria-label" in attributes
    ]
    others = [title for title in titles[2:] if not title.startswith("error vectors")]
    return titles[:2], others


def page_tables(report: Report) -> list[DisplayTable]:
    """The tables of a page, those that are folded away too, but for the one that gives all at a glance."""
    parts = list(parts_for("html", dive_document(report)))
    return [part for part in parts if isinstance(part, DisplayTable) and part.links is None]


@pytest.fixture(scope="module")
def replay() -> Replay:
    return replay_log(SAMPLE, load_config("fog", overrides=[DVL_NOISE]))


@pytest.fixture(scope="module")
def result(
    replay: Replay, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Document, Report, bytes]:
    return saved(replay, tmp_path_factory.mktemp("html") / "result")


def test_verdict_comes_first_and_every_cell_of_every_table_is_there(
    result: tuple[Document, Report, bytes],
) -> None:
    document, report, _ = result
    aided, (position, *_) = report.filters["aided"], report.tables.evidence
    word, against, statement, acts, start, convergence, predicted, plan, _ = document.texts["p"][
        :9
    ]
    assert (word, against) == ("one dive", "aided against baseline")
    change_pct = 100.0 * abs(finite(position.ratio) - 1.0)
    assert statement.startswith(f"On this dive position {change_pct:.1f}")
    assert acts.startswith("Acts: moves the track by ")
    assert start.startswith("Start: heading of the reference (")
    assert convergence.startswith("Convergence: ")
    assert re.match(
        r"A verdict takes 3 dives; about \d+ such dives would show a change of 10\s%\.$", plan
    )
    assert predicted.startswith(f"Predicted: {aided.mean_improvement_pct:.1f}")
    assert "Not confirmed" in predicted
    # On a page a number and its unit are on one line.
    cells = {cell.strip().replace("\xa0", " ") for cell in document.texts["td"]}
    for table in page_tables(report):
        assert table.title in document.texts["h3"]
        for row in table.rows:
            assert set(row) <= cells
    assert len(document.texts["h2"]) == 4


def test_every_plot_is_there_with_a_line_for_each_filter(
    result: tuple[Document, Report, bytes],
) -> None:
    document, _, _ = result
    first, titles = pictures(document)
    assert [title.split()[-1] for title in first] == ["[m]", "[m]"]
    assert [f"{state.label} [{state.unit}]" for state in STATES] == titles[14:26]
    assert [title.split()[-1] for title in titles[9:14]] == [
        "[m]",
        "[m]",
        "[deg]",
        "[deg]",
        "[m/s]",
    ]
    assert len([title for title in titles if "position error" in title]) == 3
    drawn = [(title.split(":")[0], title.split()[-1]) for title in titles if "NIS" in title]
    assert drawn == [("baseline", "velocity"), ("aided", "velocity"), ("aided", "acceleration")]
    assert len(titles) == 9 + 2 + 3 + 12 + 3 + 4 + 3
    assert document.count("path", "line") > 2 * 12 + 2 * 9
    assert document.count("svg", "strip") == 7
    paths = [attributes["d"] for tag, attributes in document.elements if tag == "path"]
    assert all(len(path) > 5 for path in paths if path)


def test_evidence_is_a_forest_plot_whose_bold_row_the_sentence_names(
    result: tuple[Document, Report, bytes],
) -> None:
    document, report, _ = result
    rows = [text for text, classes in forest_rows(document)]
    bold = [text for text, classes in forest_rows(document) if "decides" in classes]
    assert [re.split(r"\d+\.", text)[0] for text in bold] == ["position"]
    assert rows[0] == bold[0]
    assert "position" in document.texts["p"][2]
    measured = {row.quantity: row for row in report.tables.evidence}
    assert f"level{measured['level'].ratio:.2f} " in rows, "one dive has no words"


def test_page_names_its_origin(result: tuple[Document, Report, bytes]) -> None:
    document, report, _ = result
    facts = document.texts["dd"]
    assert report.log.sha256 in facts
    assert f"insdvl-replay {report.tool.version}" in facts
    assert "[filters.aided]" in document.texts["pre"][1]
    assert document.texts["pre"][0].startswith("# ")
    assert {channel.topic for channel in report.log.channels} <= set(document.texts["td"])


def test_settings_that_differ_from_the_defaults_are_by_themselves() -> None:
    config = msgspec.to_builtins(
        load_config(
            "levy-klein", overrides=["dvl.scale=1.01", "filters.aided.acceleration.window=5"]
        )
    )
    heading, *changed = changed_settings(config).split("\n")
    assert heading.startswith("# ")
    of_preset = 'initial.uncertainty = "settings"'
    assert changed == [
        "dvl.scale = 1.01",
        of_preset,
        "noise.fit = []",
        "filters.aided.acceleration.window = 5",
    ]


def test_turns_and_silence_of_the_dvl_are_shaded_behind_every_panel_over_time(
    tmp_path: Path,
) -> None:
    """A figure-eight turns, and its DVL is silent for twenty seconds."""
    dive = simulate_dive("figure-eight", seed=1, duration_s=150.0, outages=[(30.0, 50.0)])
    replay = replay_dive(dive, load_config(overrides=["evaluation.starts=1"]))
    shades = shades_of(replay)
    [silent] = [shade for shade in shades if shade.style == "silent"]
    assert silent.begin == pytest.approx(30.0, abs=1.5)
    assert silent.end == pytest.approx(50.0, abs=1.5)
    turns = [shade for shade in shades if shade.style == "turn"]
    assert turns
    for figure in replay_figures(replay):
        for panel in figure.panels:
            assert bool(panel.shades) == (
                panel.x_label == "time [s]" and panel.x_scale == "linear"
            )
    document, _, _ = saved(replay, tmp_path / "shaded")
    assert document.count("path", "silent") == document.count("path", "turn") > 20


def test_errors_fill_their_panels_and_all_panels_over_time_have_one_axis() -> None:
    """Three sigma is more than ten times the errors where sensors are far better than the settings say."""
    replay = replay_log(SAMPLE, load_config("levy-klein"))
    figures = {figure.title: figure for figure in replay_figures(replay)}
    panels = figures["Errors against the reference (3 sigma)"].panels[:6]
    for panel in panels:
        largest = max(float(np.nanmax(np.abs(curve.y))) for curve in panel.curves)
        assert panel.y_limits is not None
        assert largest <= panel.y_limits[1] <= 1.7 * largest
    assert any(
        curve.band is not None and np.nanmax(curve.band[1]) > 17.0 for curve in panels[4].curves
    )
    over_time = [
        panel
        for figure in figures.values()
        for panel in figure.panels
        if panel.x_label == "time [s]"
    ]
    (x_limits,) = {
        panel.x_limits for panel in [*over_time, *error_panel(replay)] if panel.x_scale == "linear"
    }
    assert x_limits == (0.0, pytest.approx((replay.end_ns - replay.start_ns) / S))
    assert {"Innovation consistency (NIS)", "Convergence"} <= set(figures)


def test_the_track_has_its_true_size(replay: Replay) -> None:
    panel = track_panel(replay)
    assert "times" not in panel.title
    drawn = {curve.label: curve for curve in panel.curves}
    for name, found in replay.errors.items():
        end_m = drawn[name].x[-1] - drawn["reference"].x[-1]
        assert end_m == pytest.approx(found.position_error_ned_m[-1, 1], abs=0.05)


def test_errors_of_a_track_are_vectors_magnified_so_that_they_are_seen(replay: Replay) -> None:
    (panel,) = error_vectors_panel(replay)
    assert panel.folded
    times = float(re.findall(r"(\S+) times as large", panel.title)[0])
    drawn = {curve.label: curve for curve in panel.curves}
    reference = drawn["reference"]
    size = max(np.ptp(reference.x), np.ptp(reference.y))
    errors = replay.errors["aided"].position_error_ned_m
    largest = np.abs(errors[:, :2]).max()
    assert 0.02 * size < times * largest <= 0.08 * size * 1.0001
    feet, tips, apart = drawn["aided"].x.reshape(-1, 3).T
    assert np.isnan(apart).all()
    assert tips[-1] - feet[-1] == pytest.approx(times * errors[-1, 1], abs=1e-6)
    assert feet[-1] == pytest.approx(reference.x[-1])


def test_page_asks_nobody_for_anything_and_runs_only_its_own_script(
    result: tuple[Document, Report, bytes],
) -> None:
    document, _, data = result
    assert not {"link", "img", "iframe", "object"} & {tag for tag, _ in document.elements}
    assert not re.search(rb"https?://(?!www.w3.org/2000/svg)|url\(|@import", data)
    [policy] = [
        attributes["content"] for _, attributes in document.elements if "http-equiv" in attributes
    ]
    [code], [style] = document.texts["script"], document.texts["style"]
    digests = [b64encode(sha256(text.encode()).digest()).decode() for text in (style, code)]
    assert policy == "default-src 'none'; style-src 'sha256-{}'; script-src 'sha256-{}'".format(
        *digests
    )
    assert not {
        name
        for _, attributes in document.elements
        for name in attributes
        if name.startswith(("on", "style"))
    }


def test_identifiers_are_unique(result: tuple[Document, Report, bytes]) -> None:
    ids = [attributes["id"] for _, attributes in result[0].elements if "id" in attributes]
    assert len(ids) == len(set(ids)) > 0


def test_notes_are_reported_with_their_counts(replay: Replay, tmp_path: Path) -> None:
    note = Note("imu_gaps", "the IMU <pauses> 3 times", 4711, "warning", "imu.max_gap_s=2")
    document, _, _ = saved(replace(replay, notes=(note,)), tmp_path / "notes")
    cells = document.texts["td"]
    assert {"4711", "warning", "the IMU <pauses> 3 times [imu_gaps]", "imu.max_gap_s=2"} <= set(
        cells
    )


def test_four_filters_without_a_reference_and_a_dive_without_accelerations(tmp_path: Path) -> None:
    dive = replace(simulate_dive("straight", seed=2, duration_s=60.0), reference=None, truth=None)
    settings = ["initial.source=level", "initial.heading_deg=30", "initial.latitude_deg=32.8"]
    settings += [
        f"filters.{name}.aiding=['velocity']"
        for name in ("baseline", "aided", "third", "fourth <&>")
    ]
    settings += ["filters.third.velocity_sd_mps=0.05"]
    replay = replay_dive(
        dive, load_config(overrides=[text for text in settings if "<" not in text])
    )
    document, report, _ = saved(replay, tmp_path / "four")
    assert list(report.filters) == ["aided", "third"]
    titles = [
        attributes["aria-label"]
        for tag, attributes in document.elements
        if "aria-label" in attributes
    ]
    assert len(titles) == 1 + 12 + 3 + 4
    assert NO_REFERENCE in document.texts["p"]


@pytest.fixture(scope="module")
def alone() -> Replay:
    """A dive of which neither reference nor truth is known."""
    dive = replace(
        simulate_dive("figure-eight", seed=0, duration_s=230.0), reference=None, truth=None
    )
    return replay_dive(dive, load_config("fog", overrides=[
        DVL_NOISE, "initial.source=level", "initial.heading_deg=30", "initial.latitude_deg=32.8"
    ]))  # fmt: skip


def test_a_dive_without_a_reference_has_a_page_of_outage_consistency_and_prediction(
    alone: Replay, tmp_path: Path
) -> None:
    document, report, data = saved(alone, tmp_path / "alone")
    first, titles = pictures(document)
    assert len(first) == 2
    assert first[0] == titles[0]
    assert titles[1].startswith("drift in 60 s")
    assert not {title for title in titles if title.startswith(("position error", "level"))}
    assert data.decode().count(NO_REFERENCE) == 1
    assert NO_REFERENCE.lower() not in report.filters["aided"].sentence.lower()
    assert forest_rows(document)[0][0].startswith("DVL outage 60 s"), (
        "every dive of two windows decides by it"
    )
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
        assert any(line.split()[:2] == ["filter", "[s]"] for line in lines), "no word is folded"
        assert "Reference error" not in words


@pytest.mark.nightly
def test_a_long_dive_stays_small_and_shows_its_outage(tmp_path: Path) -> None:
    """Three hours, many times as many samples as a panel has columns: more make the page no larger."""
    dive = simulate_dive("lawnmower", seed=3, duration_s=3 * 3600.0, outages=[(6000.0, 6600.0)])
    _, _, data = saved(replay_dive(dive, load_config("levy-klein")), tmp_path / "long")
    assert len(data) < 600_000
    assert b"time [h]" in data
    assert b"94.4 %" in data


@pytest.mark.nightly
def test_a_page_of_eight_filters_stays_small(tmp_path: Path) -> None:
    """Longer series than a panel has columns, accelerations, an outage: all figures that there are, and all tables."""
    dive = simulate_dive("lawnmower", seed=3, duration_s=1200.0, outages=[(1000.0, 1060.0)])
    settings = ["filters.aided.acceleration.window=3"]
    for number in range(1, 5):
        settings += [
            f"filters.sd_{number}.{key}"
            for key in ("aiding=['velocity']", f"velocity_sd_mps={number / 500}")
        ]
    for window in (4, 5):
        keys = ("aiding=['velocity', 'acceleration']", f"acceleration.window={window}")
        settings += [f"filters.window_{window}.{key}" for key in keys]
    replay = replay_dive(dive, load_config(overrides=settings))
    assert len(replay.histories) == 8
    document, _, data = saved(replay, tmp_path / "eight")
    assert "Convergence" in document.texts["strong"]
    assert len(data) < 590_000, "with room for notes and channels"


def test_a_short_dive_stays_small(result: tuple[Document, Report, bytes]) -> None:
    assert len(result[2]) < 600_000


def test_time_axis_has_a_unit_that_suits_the_dive() -> None:
    labels = {length_s: Clock(0, length_s * S).label for length_s in (424, 1500, 9 * 3600)}
    assert labels == {424: "time [s]", 1500: "time [min]", 9 * 3600: "time [h]"}
    np.testing.assert_allclose(Clock(S, 9 * 3600 * S).time(np.array([S, 1801 * S])), [0.0, 0.5])


def test_coverage_falls_where_samples_are_missing_or_invalid() -> None:
    time_ns = np.concatenate([np.arange(0, 40), np.arange(60, 101)]) * S
    valid = (time_ns < 80 * S) | (time_ns >= 90 * S)
    shares = covered_shares(time_ns, valid, 0, 100 * S, 10)
    np.testing.assert_allclose(shares, [1, 1, 1, 1, 0.15, 0, 1, 1, 0, 1], atol=1e-12)


@pytest.mark.parametrize("samples", [0, 1])
def test_coverage_of_a_silent_sensor_is_nothing(samples: int) -> None:
    assert (
        covered_shares(np.arange(samples), np.ones(samples, dtype=bool), 0, S, 4).tolist()
        == [0.0] * 4
    )


def test_any_text_is_text() -> None:
    table = DisplayTable("<t>", ("a\nb", "&"), "lr", (("<script>", "1"), ('"', "2")), "<f>")
    document = Document(
        page(
            [
                Title("<h>"),
                "<p>",
                Callout("<l>"),
                Heading("Über & <all>"),
                table,
                Html("<em>x</em>"),
            ]
        ).decode()
    )
    assert document.texts["h1"] == ["<h>"]
    assert document.texts["td"] == ["<script>", "1", '"', "2"]
    assert document.texts["em"] == ["x"]
    assert "script" not in document.texts
    assert "#" + next(
        attributes["id"] for _, attributes in document.elements if "id" in attributes
    ) in {attributes.get("href") for _, attributes in document.elements}
