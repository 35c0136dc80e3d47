"""References and truths whose numbers end before their rows do: what is NaN counts as missing, and is told."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from frames import frame, frames

from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.quantities import REFERENCE_QUANTITIES
from insdvl_replay.evaluation.notes import reference_rate_notes
from insdvl_replay.evaluation.reference_errors import covered_share
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.preparation.prepared import with_reference_at_imu
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.show.result_files import save_replay
from insdvl_replay.sim.dive import START_NS, simulate_dive
from insdvl_replay.studies.window import dive_windows

SECOND = 1_000_000_000
ENDS_S = 20.0
DURATION_S = 100.0
OF_QUANTITY = {
    "position": ["position_h", "depth", "position_h_pct"],
    "velocity_n": ["velocity_n", "velocity_e", "velocity_d"],
    "mat_nb": ["roll", "pitch", "heading"],
}
NAMES = {"position": "positions and heights", "velocity_n": "velocities", "mat_nb": "attitudes"}


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("straight", duration_s=DURATION_S, imu_rate_hz=50.0, seed=4)


def ended(values: Floats, time_ns: TimeNs, at_s: float = ENDS_S) -> Floats:
    cut = values.copy()
    cut[time_ns > START_NS + round(at_s * SECOND)] = np.nan
    return cut


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def without_end(dive: Dive, *quantities: str) -> Dive:
    reference = reference_of(dive)
    cut = {
        quantity: ended(getattr(reference, quantity), reference.time_ns) for quantity in quantities
    }
    return replace(dive, reference=replace(reference, **cut))


def notes(replay: Replay | Dive, code: str) -> list[Note]:
    return [note for note in replay.notes if note.code == code]


def errors_of(replay: Replay) -> Any:
    table = frame(replay.tables.reference_error)
    return table[table["filter"] == "aided"].set_index("quantity")


# --- A reference.


@pytest.mark.parametrize("quantity", OF_QUANTITY)
def test_quantity_that_turns_nan_is_reported_and_evaluated_where_it_is(
    tmp_path: Path, dive: Dive, quantity: str
) -> None:
    path = tmp_path / "dive.mcap"
    write_dive(path, without_end(dive, quantity))
    replay = replay_log(path, Config())
    (covered,) = notes(replay, "reference_coverage")
    assert covered.severity == "warning"
    assert re.match(rf"{NAMES[quantity]} .*\b20 %", covered.text)
    table, whole = errors_of(replay), errors_of(replay_dive(dive, Config()))
    rows = OF_QUANTITY[quantity]
    others = [name for name in REFERENCE_QUANTITIES if name not in rows]
    assert set(table.loc[rows, "status"]) == {"partly covered"}
    assert set(table.loc[others, "status"]) == {"compared"}
    assert set(table.loc[rows, "samples"]) == {100}, "5 Hz for 20 s"
    np.testing.assert_allclose(
        table.loc[others, ["rmse", "final"]].astype(float),
        whole.loc[others, ["rmse", "final"]].astype(float),
        rtol=1e-3,
    )


def test_reader_counts_what_is_not_finite_and_says_from_when(tmp_path: Path, dive: Dive) -> None:
    path = tmp_path / "dive.mcap"
    write_dive(path, without_end(dive, "velocity_n", "mat_nb"))
    found = notes(read_dive(path, Config()), "reference_not_finite")
    assert [note.count for note in found] == [400, 400]
    for note, quantity in zip(found, ("velocities", "attitudes"), strict=True):
        assert re.match(rf"reference: 400 {quantity} of 501 .*\b20\.200 s", note.text)


@pytest.mark.parametrize("missing", [(), ("velocity_n",), ("position",)])
def test_what_a_reference_never_gives_is_not_missed(
    tmp_path: Path, dive: Dive, missing: tuple[str, ...]
) -> None:
    reference = reference_of(dive)
    never = {quantity: np.full_like(getattr(reference, quantity), np.nan) for quantity in missing}
    path = tmp_path / "dive.mcap"
    write_dive(path, replace(dive, reference=replace(reference, **never)))
    replay = replay_log(path, load_config(overrides=["initial.latitude_deg=32.8"]))
    assert not notes(replay, "reference_not_finite")
    assert not notes(replay, "reference_coverage")


def test_reference_that_turns_nan_as_a_whole(tmp_path: Path, dive: Dive) -> None:
    path = tmp_path / "dive.mcap"
    write_dive(path, without_end(dive, *OF_QUANTITY))
    replay = replay_log(path, Config())
    (covered,) = notes(replay, "reference_coverage")
    assert re.match(r"positions, heights, velocities and attitudes .*\b20 %", covered.text)
    table = errors_of(replay)
    assert set(table["samples"]) == {100}
    # The straight dive goes at 2 m/s, and stood still for nothing.
    percent = table.loc["position_h_pct", "rmse"] / table.loc["position_h", "rmse"]
    assert percent == pytest.approx(100.0 / (2.0 * ENDS_S), rel=0.02)
    # The same as if its rows had ended.
    replay = replay_dive(without_end(dive, *OF_QUANTITY), Config())
    short = reference_of(dive).rows(
        reference_of(dive).time_ns <= START_NS + round(ENDS_S * SECOND)
    )
    cut = replay_dive(replace(dive, reference=short), Config())
    for name in ("reference_error", "credibility"):
        numbers = frames(replay.tables)[name].select_dtypes("number")
        np.testing.assert_allclose(
            numbers, frames(cut.tables)[name].select_dtypes("number"), rtol=1e-9
        )
    assert [note.code for note in notes(replay, "reference_slow")] == [
        note.code for note in notes(cut, "reference_slow")
    ]


def test_turns_of_a_filter_that_broke_down_are_those_that_it_knew() -> None:
    time_ns = np.arange(11) * SECOND
    headings = np.where(time_ns < 7 * SECOND, 0.3 * time_ns / SECOND, np.nan)
    mat_nb = mat_from_rpy(np.column_stack([np.zeros((11, 2)), headings]))
    velocity_n = np.column_stack([np.cos(headings), np.sin(headings), np.zeros(11)])
    history: Any = SimpleNamespace(time_ns=time_ns, mat_nb=mat_nb, velocity_n=velocity_n)
    (slow,) = reference_rate_notes(history, time_ns[::2])
    assert "turns by up to 34 deg" in slow.text
    assert "nan" not in f"{slow.text} {slow.hint}"


def test_number_in_the_last_row_does_not_cover_what_is_before(dive: Dive) -> None:
    reference = reference_of(dive)
    velocity_n = ended(reference.velocity_n, reference.time_ns)
    velocity_n[-1] = reference.velocity_n[-1]
    found = notes(
        replay_dive(replace(dive, reference=replace(reference, velocity_n=velocity_n)), Config()),
        "reference_coverage",
    )
    (covered,) = found
    assert re.match(r"velocities .*\b20 %", covered.text)


def test_reference_of_nan_alone_is_none(dive: Dive) -> None:
    reference = reference_of(dive)
    nothing = replace(
        reference,
        **{quantity: np.full_like(getattr(reference, quantity), np.nan) for quantity in NAMES},
    )
    assert with_reference_at_imu(replace(dive, reference=nothing), Config()).reference is None
    level = Initial(source="level", heading_deg=30.0, latitude_deg=32.8)
    replay = replay_dive(replace(dive, reference=nothing), Config(initial=level))
    assert set(frame(replay.tables.reference_error)["status"]) == {"no reference"}


@pytest.mark.parametrize(
    "quantities", [("position",), ("velocity_n",), ("mat_nb",), tuple(OF_QUANTITY)]
)
@pytest.mark.nightly
def test_pages_and_trajectories_of_a_reference_that_ends_are_whole(
    tmp_path: Path, dive: Dive, quantities: tuple[str, ...]
) -> None:
    replay = replay_dive(without_end(dive, *quantities), Config())
    (tmp_path / "result").mkdir()
    save_replay(replay, tmp_path / "result")
    page = (tmp_path / "result" / "report.html").read_text()
    assert "NaN" not in page.replace("NaN is", "")
    assert "nan," not in page


def test_window_study_leaves_out_what_the_reference_lacks(dive: Dive) -> None:
    whole, _, _ = dive_windows(dive, Config(), 4)
    cut, _, _ = dive_windows(without_end(dive, "mat_nb"), Config(), 4)
    assert np.isfinite(cut["rmse_mps2"]).all()
    assert (cut["samples"] < 0.25 * whole["samples"]).all()


# --- The truth.


def test_truth_that_turns_nan_is_reported(tmp_path: Path, dive: Dive) -> None:
    assert dive.truth is not None
    cut = replace(dive.truth, gyro_bias_b=ended(dive.truth.gyro_bias_b, dive.truth.time_ns))
    path = tmp_path / "dive.mcap"
    write_dive(path, replace(dive, truth=cut))
    replay = replay_log(path, Config())
    (covered,) = notes(replay, "truth_coverage")
    assert covered.severity == "warning"
    assert re.match(r"gyro biases .*\b20 %", covered.text)
    (missing,) = notes(replay, "truth_not_finite")
    assert missing.count == 400
    table = frame(replay.tables.credibility).query("filter == 'aided'").set_index("quantity")
    assert table.loc["bg_x", "samples"] == 100
    assert table.loc["ba_x", "samples"] == 500
    assert not notes(replay_dive(dive, Config()), "truth_coverage")


# --- The share.


def test_share_is_what_is_between_neighbours() -> None:
    time_ns = SECOND * np.arange(101, dtype=np.int64)
    known = np.ones(101, dtype=bool)
    assert covered_share(time_ns, known, 0, 100 * SECOND) == 1.0
    known[1::2] = False
    assert covered_share(time_ns, known, 0, 100 * SECOND) == 1.0, "every second row, steadily"
    known[31:60] = False
    assert covered_share(time_ns, known, 0, 100 * SECOND) == pytest.approx(0.7, abs=1e-12)
    assert covered_share(time_ns, np.zeros(101, dtype=bool), 0, 100 * SECOND) == 0.0
    assert covered_share(time_ns, known, 200 * SECOND, 300 * SECOND) == 0.0
