"""How the benchmark of histories draws versions of a filter, and how it counts the steps that are named."""

import math
from collections.abc import Callable
from pathlib import Path

import history_worlds
import numpy as np
import pytest
from history_worlds import (
    VERSIONS,
    WORLDS,
    HistoryWorld,
    JudgedLake,
    Task,
    drawn_logs,
    judged_lake,
    page,
)


def test_a_step_moves_all_dives_from_its_version_on() -> None:
    world = HistoryWorld(5, 0.2, 0.0, 0.8)
    logs = drawn_logs(world, 2, np.random.default_rng(1))
    assert logs.shape == (VERSIONS, 5)
    np.testing.assert_array_equal(logs[0], logs[1])
    np.testing.assert_allclose(logs[2:] - logs[:1], math.log(0.8))
    assert float(np.std(logs[0])) > 0.05


def test_dives_and_versions_scatter_as_told() -> None:
    logs = drawn_logs(HistoryWorld(4000, 0.2, 0.1), 1, np.random.default_rng(1))
    assert float(np.std(logs.mean(axis=0))) == pytest.approx(
        math.hypot(0.2, 0.1 / math.sqrt(VERSIONS)), rel=0.05
    )
    assert float(np.std(logs - logs.mean(axis=0))) == pytest.approx(
        0.1 * math.sqrt(1.0 - 1.0 / VERSIONS), rel=0.05
    )


def all_lakes(
    monkeypatch: pytest.MonkeyPatch, said: Callable[[np.ndarray], tuple[int, ...]]
) -> list[JudgedLake]:
    """Let a rule of the test, which knows the drawn logs, stand in for the tool."""
    kept = list[np.ndarray]()
    monkeypatch.setattr(history_worlds, "lake_template", lambda: None)
    monkeypatch.setattr(history_worlds, "write_lake", lambda _, __, logs: kept.append(logs))

    def steps(_: Path) -> tuple[int, ...]:
        return said(kept[-1])

    monkeypatch.setattr(history_worlds, "history_steps", steps)
    return [
        judged_lake(Task(world, number, 5)) for world in range(len(WORLDS)) for number in range(6)
    ]


def unmet(text: str) -> list[str]:
    """Name the rows with a star."""
    return [line.split("|")[1].strip() for line in text.splitlines() if " * |" in line]


def large_steps(logs: np.ndarray) -> tuple[int, ...]:
    """Name versions whose mean is far from that of the one before."""
    moved = np.abs(np.diff(logs.mean(axis=1)))
    return tuple(int(version) + 1 for version in np.flatnonzero(moved > 0.18))


def test_a_rule_that_sees_large_steps_meets_what_is_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text, all_met = page(all_lakes(monkeypatch, large_steps), 1.0)
    assert all_met, text


def test_a_rule_that_names_every_version_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    lakes = all_lakes(monkeypatch, lambda _: tuple(range(1, VERSIONS)))
    text, all_met = page(lakes, 1.0)
    assert not all_met
    assert unmet(text) == ["no step, any version is named", "a step, another version is named"]


def test_a_rule_that_names_none_finds_none(monkeypatch: pytest.MonkeyPatch) -> None:
    text, all_met = page(all_lakes(monkeypatch, lambda _: ()), 1.0)
    assert not all_met
    assert unmet(text) == ["a step of which s is a quarter at most, found"]
