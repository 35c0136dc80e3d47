"""Samples that never came into a log: what their stamps tell, and where they tell nothing."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import Note
from insdvl_replay.core.notes import note
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.columns.clean import note_lost_samples
from insdvl_replay.sim.dive import simulate_dive

STEP_NS = 10_000_000
COUNT = 4000
REGULAR = STEP_NS * np.arange(COUNT)


@dataclass
class Stamps:
    """As much of a cleaner as the note needs."""

    times: np.ndarray
    notes: list[Note] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.times = np.sort(self.times.astype(np.int64))
        self.rows = np.arange(self.times.size)

    def note(self, code: str, count: int, first: np.ndarray, **fields: Any) -> None:
        self.notes.append(note(f"imu_{code}", count, first=len(first), **fields))


def told(times: np.ndarray) -> list[Note]:
    stamps = Stamps(times)
    note_lost_samples(stamps)  # type: ignore[arg-type]
    return stamps.notes


def kept(count: int, share: float) -> np.ndarray:
    """Rows of which a share is lost at random; the first and the last stay, so that all losses lie between."""
    keep = np.random.default_rng(5).random(count) >= share
    keep[[0, -1]] = True
    return np.asarray(keep)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("straight", seed=3, duration_s=120.0)


def some(columns: Any, share: float) -> Any:
    keep = kept(columns.time_ns.size, share)
    arrays = {
        name: value for name, value in vars(columns).items() if isinstance(value, np.ndarray)
    }
    return replace(
        columns, **{name: value[keep] for name, value in arrays.items() if len(value) == keep.size}
    )


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_losses_of_each_role_are_counted(share: float, dive: Dive, tmp_path: Path) -> None:
    assert dive.reference is not None
    fewer = replace(
        dive,
        imu=some(dive.imu, share),
        dvl=some(dive.dvl, share),
        reference=some(dive.reference, share),
        truth=None,
    )
    write_dive(tmp_path / "dive.mcap", fewer)
    notes = {
        note.code: note
        for note in read_dive(tmp_path / "dive.mcap", Config()).notes
        if "lost_s" in note.code
    }
    if not share:
        assert not notes
        return
    for role in ("imu", "dvl", "reference"):
        before, after = (getattr(whole, role).time_ns.size for whole in (dive, fewer))
        note = notes[f"{role}_lost_samples"]
        assert (note.count, note.severity) == (before - after, "warning")
        assert (
            f"{note.count} samples, {100.0 * note.count / before:.2g} % of all, are missing"
            in note.text
        )


@pytest.mark.parametrize(
    ("share", "jitter"), [(0.005, 0.02), (0.01, 0.0), (0.2, 0.02), (0.6, 0.0), (0.6, 0.02)]
)
def test_all_losses_are_found_up_to_long_pauses(share: float, jitter: float) -> None:
    keep = kept(COUNT, share)
    (note,) = told((REGULAR + np.random.default_rng(2).normal(0.0, jitter * STEP_NS, COUNT))[keep])
    assert note.count == pytest.approx(COUNT - keep.sum(), rel=0.03)
    assert note.severity == ("warning" if share >= 0.05 else "info")


def test_half_of_a_slow_reference_is_missed() -> None:
    (note,) = told((10**9 * np.arange(120))[kept(120, 0.5)])
    assert note.count == pytest.approx(120 - kept(120, 0.5).sum(), abs=3)


@pytest.mark.parametrize(
    "times",
    [
        REGULAR,
        np.delete(REGULAR, [100, 900, 2000]),
        np.delete(REGULAR, slice(1000, 2000)),
        np.repeat(REGULAR, 2),
        REGULAR + np.random.default_rng(1).normal(0.0, 0.15 * STEP_NS, COUNT),
        REGULAR + np.random.default_rng(1).normal(0.0, 0.4 * STEP_NS, COUNT),
        np.cumsum(np.random.default_rng(1).exponential(STEP_NS, COUNT)),
        np.concatenate([REGULAR[:2000], REGULAR[2000::2]]),
        np.concatenate([REGULAR[start : start + 20 : 1 + start // 20 % 2] for start in range(0, COUNT, 20)]),
        STEP_NS * np.round(1.111 * np.arange(COUNT)),
        STEP_NS * np.round(1.45 * np.arange(COUNT)),
        np.cumsum(STEP_NS * (1.0 + 0.8 * np.sin(np.arange(COUNT) / 500.0))),
        np.cumsum(np.where(np.arange(COUNT) % 2, 1, 3) * STEP_NS),
        (4 * STEP_NS * np.arange(1000)[:, None] + STEP_NS // 100 * np.arange(4)).ravel(),
        np.arange(1),
    ],
    ids=["regular", "three lost", "outage", "repeats", "jitter", "much jitter", "at random", "other rate",
         "rates in turn", "polled", "polled slowly", "ping rate by height", "alternating", "bursts", "one"],
)  # fmt: skip
def test_nothing_is_said_where_stamps_tell_nothing(times: np.ndarray) -> None:
    assert told(times) == []
