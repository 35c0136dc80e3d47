"""Filters of the user's run again: those whose answers differ have no verdict, and the built-in ones do not move."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import unrepeatable
from unrepeatable import CHAOS_M

from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ImuColumns, ReferenceColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.evaluation.answers import PROVED, pooled_candidate
from insdvl_replay.evaluation.repeats import Change, Repeat, apart_m, metres
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.preparation.user_runs import LATER_NS, with_repeated_samples
from insdvl_replay.sim.dive import simulate_dive

EXAMPLES = Path(__file__).parents[2] / "examples" / "candidates"
FILTERS = {"baseline": Filter(aiding=("velocity",)), "beams": Filter(aiding=("beams",))}


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("lawnmower", seed=3, duration_s=220.0, grade="mems", imu_rate_hz=50.0)


@pytest.fixture(scope="module")
def short() -> Dive:
    """A dive without the windows of an outage test, over which a filter has fewer runs."""
    return simulate_dive("lawnmower", seed=3, duration_s=80.0, grade="mems", imu_rate_hz=50.0)


def config(mine: Filter | None = None, **evaluation: Any) -> Config:
    filters = FILTERS if mine is None else {"baseline": FILTERS["baseline"], "mine": mine}
    settings: Config = load_config("mems")
    # As small as the simulated one.
    dvl = msgspec.structs.replace(settings.dvl, velocity_sd_mps=0.0045)
    return msgspec.structs.replace(
        settings, filters=filters, dvl=dvl, evaluation=Evaluation(**({"starts": 1} | evaluation))
    )


def of_class(name: str) -> Filter:
    return Filter(candidate=f"unrepeatable:{name}")


def notes_of(replay: Replay, code: str) -> list[Note]:
    return [note for note in replay.notes if note.code == code]


# --- What is said of them.


def test_random_answers_have_no_verdict_and_their_spread_is_said(short: Dive) -> None:
    replay = replay_dive(short, config(of_class("Random")))
    found = replay.verdicts["mine"]
    assert found.verdict == Verdict.NOT_REPEATABLE
    assert re.search(
        r"mine gives another answer in a second run, which moves its position by [\d.]+ m?m \(rms\), \d+ % of the "
        r"error of baseline",
        found.reason,
    )
    assert found.reason.removeprefix("mine") in found.sentence
    assert {row.role for row in replay.tables.evidence if row.filter == "mine"} == {Role.SHOWN}
    assert not notes_of(replay, "answers_repeat")
    assert "warning" in {note.severity for note in notes_of(replay, "answers_differ")}
    assert [note.text for note in notes_of(replay, "not_evaluated")] == [
        f"there is no verdict on mine, which is not repeatable: {found.reason}"
    ]


@pytest.mark.nightly
def test_equal_answers_have_the_digest_of_the_solution(dive: Dive) -> None:
    first, second = (replay_dive(dive, config(of_class("Level"))) for _ in range(2))
    [note] = notes_of(first, "answers_repeat")
    assert re.search(r"SHA-256 [0-9a-f]{16}", note.text)
    assert first.notes == second.notes
    assert not notes_of(first, "answers_differ")
    assert first.verdicts["mine"].verdict == Verdict.UNDECIDED, (
        "one dive, with a verdict of no other kind"
    )


@pytest.mark.nightly
def test_answers_that_differ_by_far_less_than_the_error_are_judged(dive: Dive) -> None:
    replay = replay_dive(dive, config(of_class("Jittering")))
    assert replay.verdicts["mine"].verdict not in (Verdict.NOT_REPEATABLE, Verdict.NOT_EVALUATED)
    [note] = notes_of(replay, "answers_differ")
    assert note.severity == "info"
    assert re.search(r"moves its position by 0\.0\d+ mm \(rms\)", note.text)


def test_an_answer_that_depends_on_the_process_does_not_repeat(short: Dive) -> None:
    replay = replay_dive(short, config(of_class("Hashing")))
    assert "in a second run" in replay.verdicts["mine"].reason


@pytest.mark.parametrize(
    ("name", "when"),
    [
        ("Chaotic", "when all stamps move by 1 us"),
        pytest.param(
            "Counting", "when one IMU sample in 10,000 is repeated", marks=pytest.mark.nightly
        ),
    ],
)
def test_an_answer_that_moves_by_what_means_nothing_has_no_verdict(
    name: str, when: str, dive: Dive
) -> None:
    replay = replay_dive(dive, config(of_class(name)))
    found = replay.verdicts["mine"]
    assert found.verdict == Verdict.NOT_REPEATABLE
    said = re.search(
        rf"moves its position by (\d+) m \(rms\), [\d.e+]+ % of the error of baseline, {when}",
        found.reason,
    )
    assert said is not None, found.reason
    # A distance that grows to its end has a root mean square of one over the root of three.
    assert float(said[1]) == pytest.approx(CHAOS_M / np.sqrt(3.0), rel=0.03)
    assert len(notes_of(replay, "answers_repeat")) == 1


@pytest.mark.nightly
def test_a_filter_that_fails_at_a_repeated_sample_has_no_verdict(dive: Dive) -> None:
    replay = replay_dive(dive, config(of_class("Refusing")))
    found = replay.verdicts["mine"]
    assert found.verdict == Verdict.NOT_REPEATABLE
    assert "mine fails when one IMU sample in 10,000 is repeated: " in found.reason
    assert "the IMU is frozen" in found.reason


@pytest.mark.nightly
def test_without_a_reference_the_drift_without_the_dvl_is_compared(dive: Dive) -> None:
    settings = config(of_class("Turning"))
    alone = msgspec.structs.replace(
        settings, reference=msgspec.structs.replace(settings.reference, independent=False)
    )
    replay = replay_dive(dive, alone)
    found = replay.verdicts["mine"]
    assert found.verdict == Verdict.NOT_REPEATABLE
    assert re.search(r"its DVL outage 30 s by \d+ % of the error of baseline", found.reason)


@pytest.mark.nightly
@pytest.mark.parametrize("is_random", [False, True])
def test_a_program_is_run_again(is_random: bool, dive: Dive, tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    lines = ["import sys", f"sys.path.insert(0, {str(Path(__file__).parent)!r})"]
    kind = "Random" if is_random else "Level"
    lines += [f"from unrepeatable import {kind}", "from insdvl_replay import run_as_program"]
    script.write_text("\n".join([*lines, f"run_as_program({kind})", ""]))
    mine = Filter(program=(sys.executable, str(script), "{dive}", "{start}", "{solution}"))
    replay = replay_dive(dive, config(mine))
    assert len(notes_of(replay, "answers_repeat")) == (not is_random)
    assert (replay.verdicts["mine"].verdict == Verdict.NOT_REPEATABLE) == is_random
    assert replay.cpu_s["mine"] > 0.1, "it starts Python"


@pytest.mark.parametrize("is_random", [False, True])
@pytest.mark.nightly
def test_a_program_that_reads_the_log_has_a_second_run_and_no_other(
    is_random: bool, dive: Dive, tmp_path: Path
) -> None:
    write_dive(tmp_path / "dive.mcap", dive)
    baseline = replay_dive(dive, config()).histories[0]
    degrees = (baseline.position / [DEG, DEG, 1.0]).tolist()
    rows = [
        (time_ns, *position)
        for time_ns, position in zip(baseline.time_ns.tolist(), degrees, strict=True)
    ]
    script = tmp_path / "mine.py"
    # Less than a metre in height, which does not decide.
    script.write_text(
        "import random, sys\n"
        f"height_m = random.random() if {is_random} else 0.0\n"
        "with open(sys.argv[3], 'w') as file:\n"
        "    print('time_ns,latitude_deg,longitude_deg,height_m', file=file)\n"
        f"    for time_ns, north, east, up in {rows}:\n"
        "        print(time_ns, repr(north), repr(east), repr(up + height_m), sep=',', file=file)\n"
    )
    mine = Filter(
        program=(sys.executable, str(script), "{dive}", "{start}", "{solution}"), input="log"
    )
    replay = replay_log(tmp_path / "dive.mcap", config(mine))
    assert not replay.histories[-1].failure
    assert len(notes_of(replay, "answers_repeat")) == (not is_random)
    [note] = notes_of(replay, "answers_repeat") + notes_of(replay, "answers_differ")
    assert note.severity == "info"
    assert "stamps" not in note.text


def test_repeats_can_be_switched_off(short: Dive) -> None:
    replay = replay_dive(short, config(of_class("Random"), repeats=False))
    assert replay.verdicts["mine"].verdict != Verdict.NOT_REPEATABLE
    assert not notes_of(replay, "answers_repeat") + notes_of(replay, "answers_differ")


@pytest.mark.nightly
def test_the_example_repeats_to_the_last_bit(dive: Dive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    replay = replay_dive(dive, config(Filter(candidate="dead_reckoning:DeadReckoning")))
    assert len(notes_of(replay, "answers_repeat")) == 1
    assert not notes_of(replay, "answers_differ")


# --- Words.


def test_a_spread_is_off_from_the_margin_on() -> None:
    assert not Repeat(Change.AGAIN, acts=0.99 * PROVED).is_off
    assert Repeat(Change.AGAIN, acts=PROVED).is_off
    assert Repeat(Change.STAMPS, failure="ended with exit code 3").is_off
    assert not Repeat(Change.AGAIN, moves_m=7.0).is_off, (
        "nothing is judged where no error is known"
    )


@pytest.mark.parametrize(
    ("dives", "not_repeatable", "word"),
    [
        (4, 4, Verdict.NOT_REPEATABLE),
        (4, 1, Verdict.NOT_EVALUATED),
        (4, 3, Verdict.NOT_REPEATABLE),
    ],
)
def test_over_dives_the_word_is_that_of_most(
    dives: int, not_repeatable: int, word: Verdict
) -> None:
    answer = pooled_candidate(
        "mine", "baseline", [], dives, reasons=["why"], not_repeatable=not_repeatable
    )
    assert answer.verdict == word


# --- The built-in filters.


def later(columns: Any) -> Any:
    """Return columns, and what they hold at times of their own, with later stamps."""
    moved = replace(columns, time_ns=columns.time_ns + LATER_NS)
    stated = getattr(columns, "stated", None)
    return (
        moved
        if stated is None
        else replace(moved, stated=replace(stated, time_ns=stated.time_ns + LATER_NS))
    )


def with_later_stamps(dive: Dive) -> Dive:
    reference: ReferenceColumns | None = later(dive.reference)
    return replace(
        dive,
        imu=later(dive.imu),
        dvl=later(dive.dvl),
        reference=reference,
        truth=later(dive.truth),
    )


def states(history: History) -> list[np.ndarray]:
    return [
        history.velocity_n,
        history.mat_nb.reshape(-1, 9),
        history.accel_bias_b,
        history.gyro_bias_b,
        history.sd,
    ]


def test_built_in_filters_do_not_move_with_all_stamps(dive: Dive) -> None:
    first, moved = replay_dive(dive, config()), replay_dive(with_later_stamps(dive), config())
    for one, other in zip(first.histories, moved.histories, strict=True):
        np.testing.assert_array_equal(other.time_ns - LATER_NS, one.time_ns)
        assert apart_m(one, other) < 1e-6
        for before, after in zip(states(one), states(other), strict=True):
            np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)


def test_built_in_filters_do_not_move_by_messages_that_were_written_twice(
    dive: Dive, tmp_path: Path
) -> None:
    order = np.insert(np.arange(len(dive.imu.time_ns)), [2001, 7001], [2000, 7000])
    imu = ImuColumns(
        dive.imu.time_ns[order], dive.imu.specific_force_b[order], dive.imu.angular_rate_b[order]
    )
    write_dive(tmp_path / "once.mcap", dive)
    write_dive(tmp_path / "twice.mcap", replace(dive, imu=imu))
    first, moved = (replay_log(tmp_path / f"{name}.mcap", config()) for name in ("once", "twice"))
    for one, other in zip(first.histories, moved.histories, strict=True):
        np.testing.assert_array_equal(other.time_ns, one.time_ns)
        assert apart_m(one, other) < 1e-6
        for before, after in zip(states(one), states(other), strict=True):
            np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)


def test_built_in_filters_move_by_hardly_anything_with_a_later_copy_of_a_sample(
    dive: Dive,
) -> None:
    repeated = replace(dive, imu=with_repeated_samples(dive.imu))
    assert len(repeated.imu.time_ns) == len(dive.imu.time_ns) + 1
    first, moved = replay_dive(dive, config()), replay_dive(repeated, config())
    for one, other in zip(first.histories, moved.histories, strict=True):
        # The copy says that the readings do not change there, so the cubics through them are others.
        error_m = first.errors[one.filter].position_error_ned_m[:, :2]
        assert (
            0.0 < apart_m(one, other) < 1e-3 * float(np.sqrt(np.mean(np.sum(error_m**2, axis=1))))
        )


def test_the_filters_of_these_tests_know_how_far_stamps_are_moved() -> None:
    assert unrepeatable.LATER_NS == LATER_NS


def test_one_sample_in_ten_thousand_is_repeated() -> None:
    imu = simulate_dive("lawnmower", seed=3, duration_s=600.0, imu_rate_hz=50.0).imu
    repeated = with_repeated_samples(imu)
    [first, second, third] = np.flatnonzero(np.diff(repeated.time_ns) == LATER_NS)
    assert (second - first, third - second) == (10_001, 10_001)
    np.testing.assert_array_equal(
        repeated.specific_force_b[first], repeated.specific_force_b[first + 1]
    )
    np.testing.assert_array_equal(
        np.delete(repeated.time_ns, [first + 1, second + 1, third + 1]), imu.time_ns
    )


# --- Processor time.


@pytest.mark.nightly
def test_the_processor_time_of_each_filter_is_known(short: Dive) -> None:
    replay = replay_dive(short, config(of_class("Burning"), repeats=False))
    assert replay.cpu_s.keys() == {"baseline", "mine"}
    assert 0.0 < replay.cpu_s["baseline"] < 60.0
    assert replay.cpu_s["mine"] > 0.3


def test_distances_are_written_without_powers_of_ten() -> None:
    written = [metres(value) for value in (0.0, 4e-5, 0.0123, 0.468, 0.9996, 1.25, 234.4)]
    assert written == ["0 m", "0.04 mm", "12 mm", "468 mm", "1000 mm", "1.2 m", "234 m"]
