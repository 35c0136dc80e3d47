"""Copies of a dive are known from their reports alone, whatever they are called and however they are encoded."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from insdvl_replay.checks.fingerprint import MOST_DIGESTS, MOST_MARKS, imu_fingerprint
from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.dive_columns import ImuColumns, nanoseconds
from insdvl_replay.core.dive_record import ImuFingerprint
from insdvl_replay.sim.dive import simulate_dive


@dataclass(frozen=True)
class Logged:
    name: str
    sha256: str = ""


@dataclass(frozen=True)
class Made:
    log: Logged
    imu_fingerprint: ImuFingerprint | None = None
    vehicle: str = ""


def made(name: str, imu: ImuColumns | None, sha256: str = "", vehicle: str = "") -> Made:
    return Made(Logged(name, sha256), None if imu is None else imu_fingerprint(imu), vehicle)


def names(reports: list[Made]) -> tuple[list[str], list[str]]:
    kept, notes = distinct_dives(reports)
    return [report.log.name for report in kept], [note.code for note in notes]


def moved(imu: ImuColumns, by_s: float) -> ImuColumns:
    return replace(imu, time_ns=imu.time_ns + nanoseconds(by_s))


def between(imu: ImuColumns, from_s: float, to_s: float) -> ImuColumns:
    begin_ns = int(imu.time_ns[0])
    return imu.within(begin_ns + nanoseconds(from_s), begin_ns + nanoseconds(to_s))


@pytest.fixture(scope="module")
def imu() -> ImuColumns:
    return simulate_dive("figure-eight", seed=1, duration_s=200.0, grade="mems").imu


def single_precision(imu: ImuColumns) -> ImuColumns:
    force_b = imu.specific_force_b.astype(np.float32).astype(np.float64)
    rate_b = imu.angular_rate_b.astype(np.float32).astype(np.float64)
    return replace(imu, specific_force_b=force_b, angular_rate_b=rate_b)


def in_text(imu: ImuColumns) -> ImuColumns:
    """Round as a table does: six decimals, and times in seconds since 1970 as a float."""
    time_ns = np.rint((imu.time_ns * 1e-9) * 1e9).astype(np.int64)
    return ImuColumns(time_ns, np.round(imu.specific_force_b, 6), np.round(imu.angular_rate_b, 6))


def other_axes(imu: ImuColumns) -> ImuColumns:
    flip = np.array([1.0, -1.0, -1.0])
    return replace(
        imu, specific_force_b=imu.specific_force_b * flip, angular_rate_b=imu.angular_rate_b * flip
    )


def whole(imu: ImuColumns) -> ImuColumns:
    return imu


def every_second(imu: ImuColumns) -> ImuColumns:
    return imu.rows(slice(None, None, 2))


def by_arrival(imu: ImuColumns) -> ImuColumns:
    """Stamp as a recorder does, which is late by up to 9 ms."""
    late_ns = np.random.default_rng(5).integers(0, 9_000_000, len(imu.time_ns))
    return replace(imu, time_ns=np.sort(imu.time_ns + late_ns))


def cut(imu: ImuColumns) -> ImuColumns:
    return between(imu, 61.0, 133.0)


@pytest.mark.parametrize("change", [single_precision, in_text, other_axes, cut])
def test_a_copy_counts_once(imu: ImuColumns, change: Callable[[ImuColumns], ImuColumns]) -> None:
    other = simulate_dive("figure-eight", seed=2, duration_s=200.0, grade="mems").imu
    reports = [made("copy", change(imu), "b"), made("whole", imu, "a"), made("other", other, "c")]
    kept, codes = names(reports)
    assert codes == ["dives_same"]
    assert kept == ["whole" if change is cut else kept[0], "other"]


@pytest.mark.parametrize("by_s", [0.02, -0.003, 3600.0, 3603.0, -7200.0, 100_000.7])
def test_a_copy_with_moved_stamps_counts_once(imu: ImuColumns, by_s: float) -> None:
    for change in (whole, cut, single_precision, in_text, other_axes, every_second, by_arrival):
        copy = made("moved", moved(change(imu), by_s), "b")
        kept, codes = names([made("whole", imu, "a"), copy])
        assert (len(kept), codes) == (1, ["dives_same"]), change


def test_dives_of_the_same_way_at_other_times_are_two(imu: ImuColumns) -> None:
    for seed in range(2, 5):
        other = simulate_dive("figure-eight", seed=seed, duration_s=200.0, grade="mems").imu
        reports = [made("one", imu), made("other", moved(other, 5000.0))]
        assert names(reports) == (["one", "other"], [])


def test_a_coarse_imu_at_rest_repeats_its_readings_in_other_dives() -> None:
    draw = np.random.default_rng(1)
    step_ns = 50_000_000
    dives = []
    for number in range(8):
        time_ns = (
            1_700_000_000_000_000_000 + number * 3_600_000_000_000 + step_ns * np.arange(2000)
        )
        force_b = np.array([0.0, 0.0, -9.8]) + 0.01 * draw.integers(-1, 2, (2000, 3))
        rate_b = 0.001 * draw.integers(-1, 2, (2000, 3))
        dives.append(made(str(number), ImuColumns(time_ns, force_b, rate_b)))
    assert names(dives) == ([dive.log.name for dive in dives], [])


def test_a_copy_under_another_name_counts_once_without_fingerprint_too() -> None:
    kept, codes = names(
        [
            made("a", None, "same"),
            made("b", None, "same"),
            made("c", None, "other"),
            made("d", None),
        ]
    )
    assert kept == ["a", "c", "d"]
    assert codes == ["dives_same"]


def test_parts_that_overlap_a_third_are_all_one_dive(imu: ImuColumns) -> None:
    first, last = made("first", between(imu, 0.0, 80.0)), made("last", between(imu, 120.0, 200.0))
    bridge = made("bridge", between(imu, 50.0, 180.0))
    assert names([first, last])[0] == ["first", "last"]
    assert names([first, last, bridge]) == (["bridge"], ["dives_same"])


@pytest.mark.parametrize("scenario", ["static", "straight"])
def test_dives_at_the_same_time_are_two(scenario: str) -> None:
    first, second = (
        simulate_dive(scenario, seed=seed, duration_s=120.0, grade="mems").imu for seed in (1, 2)
    )
    assert names([made("one", first), made("two", second)]) == (["one", "two"], [])


@pytest.mark.parametrize(
    ("pause_s", "vehicle", "codes"),
    [
        (0.01, "", ["dives_continue"]),
        (3.0, "", ["dives_continue"]),
        (10.0, "", ["dives_continue"]),
        (59.0, "", ["dives_continue"]),
        (61.0, "", []),
        (0.01, "another", []),
    ],
)
def test_files_of_one_recording_are_told(
    imu: ImuColumns, pause_s: float, vehicle: str, codes: list[str]
) -> None:
    length_s = float(imu.time_ns[-1] - imu.time_ns[0]) * 1e-9
    after = simulate_dive("straight", seed=5, duration_s=100.0).imu
    later = moved(after, length_s + pause_s)
    assert names([made("second", later, vehicle=vehicle), made("first", imu)]) == (
        ["second", "first"],
        codes,
    )


@pytest.mark.parametrize(
    ("from_s", "names_told", "codes"),
    [
        (93.0, ["first", "second"], ["dives_continue"]),  # no whole ten seconds are in both
        (83.0, ["second"], ["dives_same"]),
    ],
)
def test_files_of_one_recording_that_overlap_are_told(
    imu: ImuColumns, from_s: float, names_told: list[str], codes: list[str]
) -> None:
    first = made("first", between(imu, 0.0, 98.0))
    second = made("second", between(imu, from_s, 198.0))
    assert names([first, second]) == (names_told, codes)


def test_the_fingerprint_of_a_long_dive_is_small_and_finds_its_parts() -> None:
    time_ns = 1_700_000_000_000_000_003 + np.arange(200_000) * 100_000_000
    draw = np.random.default_rng(1)
    long = ImuColumns(
        time_ns, draw.standard_normal((200_000, 3)), draw.standard_normal((200_000, 3))
    )
    assert 100 < len(imu_fingerprint(long).digests) <= MOST_DIGESTS
    part = long.rows(slice(50_000, 60_000))
    assert names([made("part", part), made("long", long)]) == (["long"], ["dives_same"])


@pytest.mark.nightly
def test_thousand_dives_are_compared_in_seconds() -> None:
    draw = np.random.default_rng(1)
    at_s = tuple(range(0, 3000, 10))
    reports = []
    for number in range(1000):
        digests = tuple(map(str, draw.integers(0, 1 << 32, len(at_s)).tolist()))
        marks = tuple(map(str, draw.integers(0, 1 << 16, MOST_MARKS).tolist()))
        marked_ms = tuple(sorted(draw.integers(0, 3_000_000, MOST_MARKS).tolist()))
        fingerprint = ImuFingerprint(0, nanoseconds(3000.0), at_s, digests, 2048, marked_ms, marks)
        reports.append(Made(Logged(str(number)), fingerprint))
    begun_s = time.process_time()
    kept, _ = distinct_dives(reports)
    assert len(kept) == 1000
    assert time.process_time() - begun_s < 5.0


@pytest.mark.parametrize(
    ("vehicle", "codes"),
    [
        ("girona", []),
        ("girana", ["vehicle_mistyped"]),
        ("giron", ["vehicle_mistyped"]),
        ("gironna", ["vehicle_mistyped"]),
        ("Girona", ["vehicle_mistyped"]),
        ("girona2", []),
        ("sparus", []),
        ("", []),
    ],
)
def test_a_vehicle_that_differs_by_one_letter_is_told(vehicle: str, codes: list[str]) -> None:
    reports = [made(name, None, name, "girona") for name in ("a", "b")]
    reports.append(made("c", None, "c", vehicle))
    kept, found = names(reports)
    assert (kept, found) == (["a", "b", "c"], codes)
    if codes:
        _, notes = distinct_dives(reports)
        assert notes[0].text.endswith("did you mean girona?")
        assert notes[0].count == 1


def test_numbered_vehicles_and_single_ones_are_no_mistakes() -> None:
    numbered = [
        made(name, None, name, vehicle)
        for name, vehicle in (("a", "auv_1"), ("b", "auv_1"), ("c", "auv_2"))
    ]
    single = [made("a", None, "a", "girona"), made("b", None, "b", "girana")]
    assert [note.code for note in distinct_dives(numbered)[1]] == []
    assert [note.code for note in distinct_dives(single)[1]] == []
