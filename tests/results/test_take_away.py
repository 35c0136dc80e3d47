"""What is taken out of a result: figures, histories, tables for a paper, and data frames in Python."""

import json
import math
import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pytest
from made_reports import report
from msgspec.structs import replace

import insdvl_replay
from insdvl_replay import DiveResult as Result
from insdvl_replay import load_config, read_result, replay_log
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError, UserError
from insdvl_replay.core.states import STATES
from insdvl_replay.document.latex import as_latex
from insdvl_replay.document.looks import strokes
from insdvl_replay.document.paper import require_width
from insdvl_replay.document.parts import DisplayTable
from insdvl_replay.document.render import render
from insdvl_replay.document.tables import number as shown_number
from insdvl_replay.logs import write_dive
from insdvl_replay.results import stored_results
from insdvl_replay.show.dive import dive_document, replay_result
from insdvl_replay.show.dives import named_result
from insdvl_replay.show.plots import PaperPlot
from insdvl_replay.show.plots.all_plots import FOR_PAPER
from insdvl_replay.sim.dive import simulate_dive

PROJECT = Path(__file__).resolve().parents[2]
SAMPLE = PROJECT / "sample_logs" / "figure_eight.mcap"


NOISE = ("--set", "dvl.beam_sd_mps=0.006")


@pytest.fixture(scope="module")
def replayed() -> Result:
    return replay_log(
        str(SAMPLE),
        load_config(preset="fog", settings={"evaluation.starts": 4, "dvl.beam_sd_mps": 0.006}),
    )


@pytest.fixture(scope="module")
def folder(replayed: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return replayed.save(tmp_path_factory.mktemp("saved") / "figure_eight")


# --- Figures.


def test_every_plot_for_a_paper_can_be_named_and_every_name_is_drawn() -> None:
    assert get_args(PaperPlot) == tuple(FOR_PAPER)


def test_plots_are_listed_where_they_are_described() -> None:
    listed = f"{', '.join(f'`{kind}`' for kind in [*FOR_PAPER][:-1])} and `{[*FOR_PAPER][-1]}`"
    page = (PROJECT / "docs" / "python.md").read_text("utf-8")
    assert listed in " ".join(page.split())
    assert listed.replace("`", "``").replace(" and ", " or ") in (Result.figure.__doc__ or "")


def test_states_are_chosen_for_sigma_only(folder: Path) -> None:
    result = read_result(folder)
    with pytest.raises(ConfigError, match=r"^states=ba: works with sigma only, not with error"):
        result.figure("error", states="ba")
    assert len(result.figure("sigma", states="ba").axes) == 3


def test_a_track_is_drawn_without_a_reference(folder: Path, tmp_path: Path) -> None:
    kept = shutil.copytree(folder, tmp_path / "kept")
    (kept / "replay.mcap").unlink()
    track = read_result(kept).figure("track")
    named = [text.get_text() for text in track.legends[0].get_texts()]
    assert named == ["baseline", "aided", "start", "end"]


@pytest.mark.parametrize("kind", FOR_PAPER)
def test_every_kind_is_drawn_with_names_and_units(kind: str, folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "drawn.svg"
    assert (
        run_command_line(["figure", str(folder), kind, "--format", "svg", "-o", str(target)]) == 0
    )
    text = target.read_text("utf-8")
    assert {"baseline", "aided"} <= set(re.findall(r">([^<>]+)</text>", text)), (
        "a legend of its own"
    )
    labels = [
        label for label in re.findall(r">([^<>]+)</text>", text) if "[" in label or "dof" in label
    ]
    assert labels
    ticks = re.findall(r">([\N{MINUS SIGN}.e+\d-]+)</text>", text)
    assert all(re.fullmatch(r"\N{MINUS SIGN}?\d+(\.\d+)?", tick) for tick in ticks), (
        "no powers of ten"
    )
    if kind == "outage":
        assert {"30", "60", "120"} <= set(ticks)
    assert "var(--" not in text, "no colour of a page"
    assert re.search(r'width="24\d\.\d+pt"', text), "88 mm are 249 pt"


@pytest.mark.parametrize("width_mm", [60.0, 88.0, pytest.param(180.0, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("kind", FOR_PAPER)
def test_no_text_of_a_figure_is_cut_or_covers_another(
    kind: str, width_mm: float, folder: Path
) -> None:
    figure = read_result(folder).figure(kind, width_mm=width_mm)
    figure.draw_without_rendering()
    assert figure.bbox.width == pytest.approx(width_mm / 25.4 * figure.dpi)
    shown = [text for legend in figure.legends for text in legend.get_texts()]
    for axes in figure.axes:
        shown += [axes.xaxis.label, axes.yaxis.label, axes._left_title]  # type: ignore[attr-defined]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            shown += [
                tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high
            ]
    boxes = {
        f"{place} {text.get_text()}": text.get_window_extent()
        for place, text in enumerate(shown) if text.get_visible() and text.get_text()
    }  # fmt: skip
    assert len(boxes) > 8
    for name, box in boxes.items():
        assert figure.bbox.x0 <= box.x0, name
        assert figure.bbox.y0 <= box.y0, name
        assert box.x1 <= figure.bbox.x1, name
        assert box.y1 <= figure.bbox.y1, name
        over = [other for other, second in boxes.items() if other != name and box.overlaps(second)]
        assert not over, (name, over)


def test_panels_share_the_time_and_the_track_has_the_reference(folder: Path) -> None:
    result = read_result(folder)
    for kind, shape in (("error", (2, 2)), ("sigma", (3, 4))):
        axes = result.figure(kind, width_mm=180.0).axes
        assert axes[0].get_gridspec().get_geometry() == shape
        assert len(axes) == shape[0] * shape[1]
        assert all(each.get_xlim() == axes[0].get_xlim() for each in axes)
        assert [each.get_xlabel() for each in axes].count("time [s]") == shape[1]
    track = result.figure("track")
    assert [text.get_text() for text in track.legends[0].get_texts()] == [
        "baseline", "aided", "reference", "start", "end",
    ]  # fmt: skip
    drawn = {
        line.get_color(): line for line in track.axes[0].get_lines() if line.get_marker() == "None"
    }
    np.testing.assert_allclose(
        drawn[strokes()["reference"].colour].get_xdata(), result.reference["position_e_m"]
    )
    assert result.figure("nis").axes[0].collections, "a band"
    with pytest.raises(UserError, match="'eror'"):
        result.figure("eror")


@pytest.mark.nightly
def test_formats_are_what_they_say_and_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    begin = {"pdf": b"%PDF", "png": b"\x89PNG", "svg": b"<?xml"}
    for format_, magic in begin.items():
        made = []
        for name in ("once", "again"):
            target = tmp_path / f"{name}.{format_}"
            assert (
                run_command_line(
                    ["figure", str(folder), "track", "--format", format_, "-o", str(target)]
                )
                == 0
            )
            made.append(target.read_bytes())
        assert made[0].startswith(magic)
        assert made[0] == made[1]


@pytest.mark.parametrize("format_", ["pdf", "svg", "png"])
@pytest.mark.nightly
def test_a_full_disk_is_reported(
    format_: str,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def full(_path: Path, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    target = tmp_path / f"error.{format_}"
    assert (
        run_command_line(["figure", str(folder), "error", "--format", format_, "-o", str(target)])
        == 2
    )
    assert f"{target}: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_width_and_states_are_those_asked_for(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "sigma.png"
    arguments = [
        "figure",
        str(folder),
        "sigma",
        "--states",
        "ba,bg_z",
        "--width",
        "180mm",
        "--format",
        "png",
    ]
    assert run_command_line([*arguments, "-o", str(target)]) == 0
    width, _ = struct.unpack(">II", target.read_bytes()[16:24])
    assert width == pytest.approx(180.0 / 25.4 * 300.0, abs=1.0)
    assert (
        run_command_line(
            [
                *arguments[:3],
                "--states",
                "ba,bg_z",
                "--format",
                "svg",
                "-o",
                str(tmp_path / "s.svg"),
            ]
        )
        == 0
    )
    shown = re.findall(r">([^<>]+ \[[^\]]+\])</text>", (tmp_path / "s.svg").read_text("utf-8"))
    assert [label for label in shown if label != "time [s]"] == [
        f"{state.label} [{state.unit}]" for state in STATES if state.id.startswith(("ba", "bg_z"))
    ]


@pytest.mark.parametrize(
    ("options", "code", "reason"),
    [
        (["error", "--width", "5"], 2, "--width 5: "),
        (["sigma", "--states", "bx"], 2, "'bx'"),
        (["sigma", "--states", "foo"], 2, "dv, phi, ba, bg, dv_n, dv_e"),
        (["error", "--states", "ba"], 2, "--states ba: "),
        (["error", "-o", "error.svg"], 2, "--format svg"),
        (["error", "-o", "error.jpg"], 2, "-o error.pdf"),
        ([], 2, "'KIND'"),
        (["speed"], 2, "'speed'"),
        (["error", "-o", "taken.pdf"], 2, "taken.pdf: "),
    ],
)
def test_wrong_uses_are_reported(
    options: list[str], code: int, reason: str, folder: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken.pdf").touch()
    assert run_command_line(["figure", str(folder), *options]) == code
    assert reason in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["taken.pdf"]


@pytest.mark.skipif(
    bool(shutil.which("xelatex") or shutil.which("pdflatex")), reason="there is LaTeX"
)
def test_pgf_without_latex_says_so(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "error.pgf"
    assert (
        run_command_line(["figure", str(folder), "error", "--format", "pgf", "-o", str(target)])
        == 2
    )
    assert capsys.readouterr().err.startswith("error: --format pgf ")
    assert not target.exists()


def test_a_picture_without_matplotlib_says_what_to_install(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert (
        run_command_line(["figure", str(folder), "error", "-o", str(tmp_path / "error.pdf")]) == 2
    )
    assert "pip install 'matplotlib>=" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# --- Histories.


def test_history_has_a_row_for_each_time_with_all_digits(tmp_path: Path) -> None:
    settings = {"evaluation.starts": 1}
    log = tmp_path / "figure_eight.mcap"
    write_dive(log, simulate_dive("figure-eight", seed=1, duration_s=60.0, imu_rate_hz=50.0))
    arguments = ["run", str(log), "-o", str(tmp_path), "--starts", "1", "--history", "csv"]
    arguments += ["--preset", "levy-klein"]
    assert run_command_line(arguments) == 0
    made = pd.read_csv(tmp_path / "figure_eight" / "history_aided.csv")
    config = load_config(preset="levy-klein", settings=settings)
    frame = replay_log(log, config).histories["aided"]
    assert list(made.columns) == list(frame.columns)
    np.testing.assert_array_equal(made["heading_deg"].to_numpy(), frame["heading_deg"].to_numpy())
    assert (np.diff(made["time_ns"]) > 0).all()
    improvement = pd.read_csv(tmp_path / "figure_eight" / "improvement.csv").set_index("state")
    last = made[made["updated"]].iloc[-1]
    assert last["ba_z_sd"] == pytest.approx(improvement.loc["ba_z", "sd"], rel=1e-12)
    assert run_command_line(arguments) == 0, "and is known again"


def test_parquet_needs_its_library_and_says_so_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert (
        run_command_line(["run", str(SAMPLE), "-o", str(tmp_path / "out"), "--history", "parquet"])
        == 2
    )
    assert "'pyarrow>=" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- LaTeX.


def paper(dives: int = 8) -> str:
    """All tables of some dives, as `run DIVES --format latex` prints them."""
    reports = [
        replace(report(), log=replace(report().log, name=f"dive_{number} & {{co}}"))
        for number in range(dives)
    ]
    results = [replay_result(found, dive_document(found)) for found in reports]
    together = named_result(reports, ("pooled", "summary"), ())
    return "".join(render(result, "latex") for result in (*results, together))


def test_latex_labels_each_table_once_and_names_its_dive() -> None:
    text = paper()
    labels = re.findall(r"\\label\{(.+?)\}", text)
    assert len(labels) == len(set(labels)) == text.count(r"\begin{table}") > 90
    assert all(re.fullmatch(r"tab:[\w.-]+:[\w-]+", label) for label in labels)
    captions = re.findall(r"\\caption\{(.+)\}", text)
    assert len(captions) == len(labels)
    for dive in range(8):
        named = [
            label
            for caption, label in zip(captions, labels, strict=True)
            if rf"dive\_{dive} \& \{{co\}}" in caption
        ]
        assert len(named) == len(labels) // 8
        assert all(label.startswith(f"tab:dive_{dive}") for label in named)
    assert re.sub(r"(?m)^%.*$", "", text).isascii(), "any LaTeX reads it"
    assert len(set(re.findall(r"label\{(.+?)\}", as_latex([*tiny(), *tiny()])))) == 2


def tiny() -> list[Any]:
    rows = (
        ("a|b<c>", shown_number(2.3e-5), "-12.5 %", "x -- y"),
        ("d", shown_number(-0.5), "-", ""),
    )
    return ["numbers", DisplayTable("Small", ("", "a_b\n[s]", "change", "r"), "lrrr", rows)]


def test_latex_has_columns_of_siunitx() -> None:
    lines = as_latex(tiny()).split("\n")
    assert lines[0] == r"% needs \usepackage{booktabs,graphicx,siunitx}"
    assert r"\begin{tabular}{lS[table-format=-1.4e-1]S[table-format=-2.1]r}" in lines
    assert r" & {a\_b [s]} & {change [\%]} & r \\" in lines
    assert r"a\textbar{}b\textless{}c\textgreater{} & 2.30e-5 & -12.5 & x -{}- y \\" in lines
    assert r"d & -0.5000 & {--} &  \\" in lines


def test_latex_is_balanced() -> None:
    """What every LaTeX asks for first, tried where there is none: braces, dollars and environments in pairs."""
    text = re.sub(r"(?m)(?<!\\)%.*$", "", paper(2) + as_latex(tiny()))
    plain = re.sub(r"\\[\\{}$&%#_]", "", text).replace(r"\width>\linewidth", "")
    assert plain.count("{") == plain.count("}")
    assert plain.count("$") % 2 == 0
    assert not re.search(r"[\^~<>|#]|(?<![a-zA-Z0-9:])_", re.sub(r"\\label\{.*?\}", "", plain)), (
        "all is escaped"
    )
    for name in ("table", "tabular"):
        assert text.count(rf"\begin{{{name}}}") == text.count(rf"\end{{{name}}}")
    column = r"(?:[lr]|p\{25mm\}|S\[table-format=[+-]?\d+(?:\.\d+)?(?:e-\d)?(?:,retain-explicit-plus)?\])"
    found = re.findall(
        rf"\\begin\{{tabular\}}\{{({column}+)\}}\n(.*?)\\end\{{tabular\}}", text, re.DOTALL
    )
    assert len(found) == text.count(r"\begin{tabular}")
    for letters, content in found:
        columns = re.findall(column, letters)
        head, *rows = (
            re.split(r" (?<!\\)& ", row) for row in content.split(" \\\\\n") if " & " in row
        )
        assert all(len(row) == len(columns) for row in (head, *rows))
        for kind, name, *cells in zip(columns, head, *rows, strict=True):
            if kind.startswith("S"):
                assert name.split("\n")[-1][0] + name[-1] == "{}"
                assert all(
                    re.fullmatch(r"\{--\}|[+-]?\d+(\.\d+)?(e[+-]\d+)?", cell.split("\n")[-1])
                    for cell in cells
                )


@pytest.mark.nightly
@pytest.mark.skipif(
    not (shutil.which("tectonic") or shutil.which("pdflatex")), reason="needs LaTeX"
)
def test_latex_compiles(tmp_path: Path) -> None:
    packages = "\\usepackage{booktabs,graphicx,siunitx}"
    (tmp_path / "paper.tex").write_text(
        f"\\documentclass{{article}}{packages}\\begin{{document}}\n{paper()}{as_latex(tiny())}\\end{{document}}\n",
        "utf-8",
    )
    program = shutil.which("tectonic") or "pdflatex"
    options = [] if "tectonic" in program else ["-interaction=nonstopmode", "-halt-on-error"]
    done = subprocess.run(
        [program, *options, "paper.tex"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert "multiply defined" not in done.stdout
    assert (tmp_path / "paper.pdf").stat().st_size > 10_000


# --- Python.


def test_public_names_are_these() -> None:
    results = {"Result", "CommandResult", "DiveResult", "DiveResults"}
    commands = {
        "calibrate",
        "check",
        "compact_lake",
        "compare",
        "compare_trajectories",
        "demo",
        "history",
        "inspect",
        "merge",
        "plan",
        "propose",
        "read_result",
        "read_results",
        "run_shard",
        "simulate",
    }
    own = {"Candidate", "Solution", "UserMeasurement", "UserNoise", "UserReadings"}
    own |= {"__version__", "compare_settings", "load_config"}
    own |= {"replay_log", "run_as_program"}
    assert set(insdvl_replay.__all__) == set(dir(insdvl_replay))
    assert set(insdvl_replay.__all__) == results | commands | own
    assert all(getattr(insdvl_replay, name) for name in insdvl_replay.__all__)
    with pytest.raises(AttributeError, match="'replays'"):
        _ = insdvl_replay.replays  # type: ignore[attr-defined]
    listed = "import sys, insdvl_replay; dir(insdvl_replay); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", listed], check=False).returncode == 0, (
        "completion loads nothing"
    )


def test_a_replay_in_python_is_that_of_the_command_line(
    replayed: Result, folder: Path, tmp_path: Path
) -> None:
    assert (
        run_command_line(
            ["run", str(SAMPLE), "-o", str(tmp_path), "--starts", "4", "--preset", "fog", *NOISE]
        )
        == 0
    )
    for name in ("evidence.csv", "trajectory.npz", "report.html"):
        assert (tmp_path / "figure_eight" / name).read_bytes() == (folder / name).read_bytes()


def test_tables_are_frames_with_the_columns_of_the_files(replayed: Result, folder: Path) -> None:
    for name, frame in replayed.tables.items():
        stored = pd.read_csv(folder / f"{name}.csv", keep_default_na=False, na_values=[""])
        assert list(frame.columns) == list(stored.columns), name
        assert len(frame) == len(stored)


def test_a_result_is_read_back(replayed: Result, folder: Path) -> None:
    again = read_result(str(folder))
    assert again.words == replayed.words == {"aided": "undecided"}
    pd.testing.assert_frame_equal(again.trajectory, replayed.trajectory)
    pd.testing.assert_frame_equal(again.tables["drift"], replayed.tables["drift"])
    with pytest.raises(ValueError, match="already"):
        again.save(folder)


def test_histories_and_reference_are_read_back(
    replayed: Result, folder: Path, tmp_path: Path
) -> None:
    again = read_result(folder)
    for name, frame in replayed.histories.items():
        pd.testing.assert_frame_equal(again.histories[name], frame, rtol=1e-12)
    pd.testing.assert_frame_equal(again.reference, replayed.reference, rtol=1e-9)
    assert len(again.reference) > 1000
    near = again.trajectory.query("filter == 'baseline'").set_index("time_s")["position_n_m"]
    north_m = again.reference.set_index("time_s")["position_n_m"].reindex(near.index)
    assert (north_m - near).abs().max() < 1.0
    shutil.copytree(folder, tmp_path / "dive")
    (tmp_path / "dive" / "replay.mcap").unlink()
    with pytest.raises(UserError, match=r"has no replay\.mcap"):
        _ = read_result(tmp_path).histories


def test_a_result_is_read_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, read_file = list[Path](), stored_results.read_file
    monkeypatch.setattr(
        stored_results, "read_file", lambda path: read.append(path) or read_file(path)
    )
    read_result(folder)
    assert read.count(folder / "report.json") == 1


def test_a_name_that_is_not_there_is_reported_those_that_are(replayed: Result) -> None:
    with pytest.raises(UserError) as caught:
        _ = replayed.tables["x"]
    assert "'x'" in str(caught.value)
    assert caught.value.hint.endswith(", ".join(replayed.tables))
    assert caught.value.__notes__ == [f"hint: {caught.value.hint}"], "a traceback shows it"
    with pytest.raises(KeyError) as nearest:
        _ = replayed.tables["evidense"]
    assert "evidence" in nearest.value.__notes__[0]
    with pytest.raises(UserError, match="filter 'x'"):
        _ = replayed.histories["x"]
    assert replayed.tables.get("x") is None


def test_a_folder_without_the_result_is_reported(folder: Path, tmp_path: Path) -> None:
    assert read_result(folder.parent).name == "figure_eight", "the one there is"
    with pytest.raises(UserError, match="nowhere: "):
        read_result(tmp_path / "nowhere")
    with pytest.raises(UserError, match=str(tmp_path)):
        read_result(tmp_path)
    for name in ("a", "b"):
        shutil.copytree(folder, tmp_path / name)
    with pytest.raises(UserError, match="holds 2 results"):
        read_result(tmp_path)
    stored = json.loads((folder / "report.json").read_text("utf-8"))
    (tmp_path / "a" / "report.json").write_text(json.dumps({**stored, "log": 3}))
    with pytest.raises(UserError, match=r"a/report.json: "):
        read_result(tmp_path / "a")


def test_a_notebook_shows_the_screen(replayed: Result) -> None:
    shown = replayed._repr_html_()
    assert "aided against baseline: on this dive " in shown
    assert shown.count("<td>") > 10
    assert "<script" not in shown
    assert str(replayed).startswith("figure_eight: 394 s")


def test_settings_are_taken_as_a_mapping_or_as_on_the_command_line() -> None:
    assert load_config(settings={"dvl.scale": 1.5}) == load_config(settings=["dvl.scale=1.5"])
    assert load_config(preset="fog") != load_config()
    arm = np.array([0.5, 0.0, -0.25])
    config = load_config(
        settings={"dvl.lever_arm_m": arm, "dvl.scale": arm[0], "evaluation.held_out": ("depth",)}
    )
    assert config == load_config(
        settings=[
            "dvl.lever_arm_m=[0.5, 0, -0.25]",
            "dvl.scale=0.5",
            'evaluation.held_out=["depth"]',
        ]
    )
    assert load_config(settings={"dvl.topic": "a\"'="}).dvl.topic == "a\"'="
    with pytest.raises(UserError, match=r"dvl\.topic: None"):
        load_config(settings={"dvl.topic": None})


@pytest.mark.nightly
def test_the_public_names_are_typed(tmp_path: Path) -> None:
    (tmp_path / "use.py").write_text(
        "from insdvl_replay import load_config, replay_log\n"
        "words: dict[str, str] = replay_log('dive.mcap', load_config(preset='fog')).words\n"
        "wrong: int = replay_log('dive.mcap').name\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", str(tmp_path / "use.py")],
        cwd=PROJECT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert re.findall(r"use\.py:(\d+): error: (.+)  \[assignment\]", done.stdout) == [
        (
            "3",
            'Incompatible types in assignment (expression has type "str", variable has type "int")',
        )
    ], done.stdout


RUN_CELLS = """
import json, sys
names = {}
for cell in json.load(open("dive.ipynb"))["cells"]:
    if cell["cell_type"] == "code":
        assert cell["outputs"] == [], "stored without outputs"
        exec("".join(cell["source"]), names)
assert list(names["results"].words) == ["aided"]
assert (names["pooled"]["dives"].max(), len(names["results"].dives)) == (8, 8)
assert len(names["error"].axes) == 4
assert "reference" in [text.get_text() for text in names["track"].legends[0].get_texts()]
assert names["track"]._repr_png_().startswith(b"\\x89PNG")
assert names["trajectory"].notna().all(axis=None)
"""


@pytest.mark.nightly
def test_the_notebook_runs_from_a_clean_kernel(tmp_path: Path) -> None:
    shutil.copy(PROJECT / "examples" / "notebook" / "dive.ipynb", tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", RUN_CELLS], cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(PROJECT), "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("width_mm", [0.0, -88.0, 59.9, math.nan, math.inf])
def test_a_width_that_no_paper_has_is_refused(width_mm: float) -> None:
    with pytest.raises(ConfigError, match="is not a width from 60 to 1000 mm"):
        require_width(width_mm, "width_mm")
