"""The one place where the benchmarks ask the tool for its verdicts: over several dives, and by intervals alone.

Everything else in the worlds of the judge is about truth and counting, and calls nothing of `insdvl_replay.evaluation`
that makes a word. If the tool names its rule otherwise, this file changes and no other.
"""

import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import msgspec
import numpy as np
from in_process import done_here
from pyarrow.parquet import read_table

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import is_beam
from insdvl_replay.core.tables import EvidenceRow, LakeRow, WhereRow, finite
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.evaluation.answers import (
    CandidateAnswer,
    CandidateOnDive,
    answer_over_dives,
    answers_together,
)
from insdvl_replay.evaluation.interval import (
    LEVEL,
    level_of_candidates,
    log_ratio_interval,
    word_of_interval,
)
from insdvl_replay.evaluation.where import pooled_where
from insdvl_replay.logs import write_dive
from insdvl_replay.nav.user_candidate import CandidateStart, Solution
from insdvl_replay.preparation.programs import UserProcesses
from insdvl_replay.preparation.replay import Replay
from insdvl_replay.preparation.user_process import solution_of_class
from insdvl_replay.results.lake import LakeWriter, require_lake
from insdvl_replay.sim.dive import simulate_dive

POSITION: Final = "position"
TEMPLATE_S: Final = 120.0
"""Of the dive whose evidence a lake begins with."""
SIZES: Final = (3, 5, 8)
"""Dives of the groups on which the tool says its word."""


# --- Groups of dives.


def drawn_groups(numbers: Sequence[int], size: int, groups: int, seed: int) -> list[list[int]]:
    """Draw groups of rows, none of which has a number twice; of rows with the same number one is drawn at random."""
    rng = np.random.default_rng((seed, size))
    rows_of = dict[int, list[int]]()
    for row, number in enumerate(numbers):
        rows_of.setdefault(number, []).append(row)
    if len(rows_of) < size:
        return []
    return [
        [
            int(rng.choice(rows_of[number]))
            for number in rng.choice(list(rows_of), size, replace=False).tolist()
        ]
        for _ in range(groups)
    ]


def word_counts(words: Counter[str]) -> str:
    """Write how often each word was said, in percent."""
    if not words:
        return "-"
    return ", ".join(
        f"{100.0 * words[word] / words.total():.0f} {word}" for word in Verdict if words[word]
    )


# --- The rule for one ratio over dives.


class Found(NamedTuple):
    """An interval over dives, the one that may be looked at after every dive, and their words."""

    low: float
    high: float
    word: str
    word_always: str


def over_dives(
    log_ratios: Sequence[float],
    *,
    level: float = LEVEL,
    vehicles: Sequence[str] | None = None,
    always: bool = True,
) -> Found:
    """Ask the tool for its interval over dives, and for its word.

    Parameters
    ----------
    log_ratios : sequence of float
        Candidate over baseline, one for each dive.
    level : float
        Of confidence.
    vehicles : sequence of str, optional
        Of each dive.
    always : bool
        Whether the word for every look is asked for, too.
    """
    found = log_ratio_interval(log_ratios, level=level, vehicles=vehicles)
    word = str(word_of_interval(found.low, found.high))
    word_always = str(word_of_interval(found.low_always, found.high_always)) if always else ""
    return Found(found.low, found.high, word, word_always)


def level_of(count: int, *, named: bool = False, is_named: bool = False) -> float:
    """Ask the tool for the level of confidence of one candidate of several."""
    return level_of_candidates(count, named=named, is_named=is_named)


# --- The whole tool: dives that were replayed, and the verdict over several of them.


@dataclass(frozen=True)
class Record:
    """What the tool keeps of one candidate in one dive, so that verdicts over dives can be made of it.

    Attributes
    ----------
    word : str
        What it says of this dive alone.
    rows : tuple of EvidenceRow
        With ratios, and with how far the candidate acts.
    reason : str
        Why the candidate is not evaluated.
    nis_per_dof : float
        Of the baseline's DVL, 1 where its noise fits; NaN where it is not known.
    """

    word: str
    rows: tuple[EvidenceRow, ...]
    reason: str = ""
    vehicle: str = ""
    nis_per_dof: float = math.nan


REFUSED: Final = Record(Verdict.NOT_EVALUATED, (), reason="the log was refused")
"""A log that is refused is as good as a dive that is not evaluated."""


def record_of(replay: Replay, candidate: str) -> Record:
    """Keep what a verdict over several dives is made of."""
    found = replay.verdicts[candidate]
    return Record(
        word=str(found.verdict),
        rows=tuple(row for row in replay.tables.evidence if row.filter == candidate),
        reason=found.reason,
        vehicle=replay.config.vehicle.name,
        nis_per_dof=_nis_per_dof(replay),
    )


def _nis_per_dof(replay: Replay) -> float:
    for row in replay.tables.consistency:
        is_dvl = row.measurement == "velocity" or is_beam(row.measurement)
        if row.filter == replay.config.baseline and is_dvl and row.dof:
            return finite(row.mean_nis) / row.dof
    return math.nan


def verdicts_over(
    baseline: str, records: Mapping[str, Sequence[Record]], *, named: str = "", primary: str = ""
) -> dict[str, str]:
    """Ask the tool for its verdicts over several dives.

    Parameters
    ----------
    records : mapping of str to sequence of Record
        By candidate, one for each dive. Several candidates share the error rate of one.
    named : str
        The candidate that was named before the run.
    primary : str
        The quantity that the settings name; empty where the tool chooses.
    """

    def answer_at(candidate: str, level: float) -> CandidateAnswer:
        dives = [_on_dive(record, baseline) for record in records[candidate]]
        return answer_over_dives(candidate, dives, primary=primary, level=level)

    answers = answers_together(records, answer_at, named)
    return {name: str(answer.verdict) for name, answer in answers.items()}


def _on_dive(record: Record, baseline: str) -> CandidateOnDive:
    return CandidateOnDive(
        log="",
        baseline=baseline,
        vehicle=record.vehicle,
        verdict=record.word,
        reason=record.reason,
        predicted_pct=None,
        rows=record.rows,
    )


def verdict_over(candidate: str, baseline: str, records: Sequence[Record]) -> str:
    """Ask the tool for its verdict over several dives on the only candidate."""
    return verdicts_over(baseline, {candidate: records})[candidate]


def words_of_groups(
    candidate: str, baseline: str, records: Sequence[Record], size: int, groups: int, seed: int
) -> str:
    """Count the words on the only candidate, on drawn groups of dives, in percent."""
    drawn = drawn_groups(range(len(records)), size, groups, seed)
    return word_counts(
        Counter(
            verdict_over(candidate, baseline, [records[row] for row in rows]) for rows in drawn
        )
    )


def log_ratio_of(record: Record, quantity: str) -> float:
    """Give the logarithm of a ratio that a dive has; NaN where it has none."""
    for row in record.rows:
        if row.quantity == quantity and row.ratio:
            return math.log(row.ratio)
    return math.nan


# --- The whole tool: trajectories that were made elsewhere.


class Compared(NamedTuple):
    """What the command that compares trajectories said of NEW.

    Attributes
    ----------
    word : str
        The verdict; empty where there is none, since files were refused.
    ratio : float
        Of the primary quantity, NEW over OLD, with its interval; NaN where there is none.
    code : int
        With which the command ended.
    """

    word: str
    ratio: float
    low: float
    high: float
    dives: int
    code: int
    stderr: str


def compared(old: Path, new: Path, reference: Path) -> Compared:
    """Ask the tool to compare two folders of trajectories."""
    done = done_here("compare", old, new, "--reference", reference, "--json", cwd=old.parent)
    if not done.stdout.strip():
        return Compared("", math.nan, math.nan, math.nan, 0, done.returncode, done.stderr)
    (answer,) = json.loads(done.stdout)["answers"]
    row = _primary_row(answer["rows"])
    return Compared(
        word=answer["verdict"],
        ratio=finite(row.get("ratio")),
        low=finite(row.get("low")),
        high=finite(row.get("high")),
        dives=int(row.get("dives") or 0),
        code=done.returncode,
        stderr=done.stderr,
    )


def _primary_row(rows: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Give the row that decides; an empty one where there is none."""
    for row in rows:
        if row["role"] == "primary":
            return row
    return {}


# --- The whole tool: parts of dives.


class WherePart(NamedTuple):
    """What the tool says of one part of the dives of an archive.

    Attributes
    ----------
    ratio : float
        Candidate over baseline; NaN where it is not known.
    stands_out : bool
        Whether the tool says that this part is not as the others.
    """

    name: str
    ratio: float
    stands_out: bool


WhereRecord = tuple[WhereRow, ...]
"""What the tool keeps of the parts of one dive."""


def where_record_of(replay: Replay, candidate: str) -> WhereRecord:
    """Keep what is said of the parts of one dive."""
    return tuple(row for row in replay.tables.where if row.filter == candidate)


def where_over(records: Sequence[WhereRecord]) -> list[WherePart]:
    """Ask the tool which parts stand out over several dives."""
    found = list[WherePart]()
    for row in pooled_where(records):
        found.append(WherePart(row.bin, finite(row.ratio), bool(row.stands_out)))
    return found


# --- The whole tool: histories of a filter.


@cache
def lake_template() -> tuple[LakeRow, ...]:
    """Return the rows of one replay, as a lake has them: those of the candidate, in each process made once."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / "dive.mcap"
        write_dive(log, simulate_dive("straight", seed=1, duration_s=TEMPLATE_S))
        done = done_here(
            "run", log, "--preset", "fog", "--lake", "lake", "--starts", "1", cwd=folder
        )
        if done.returncode:
            raise RuntimeError(done.stderr)
        rows = read_table(folder / "lake" / "rows").to_pylist()
    of_candidate = [row for row in rows if row["filter"] != "baseline"]
    return tuple(msgspec.convert(row, LakeRow) for row in of_candidate)


def write_lake(lake: Path, template: Sequence[LakeRow], logs: Floats) -> None:
    """Write the evidence of several versions on the same dives, a day for each version.

    Parameters
    ----------
    logs : ndarray, shape (versions, dives)
        Log ratios of the position error.
    """
    require_lake(lake, ())
    for version, of_version in enumerate(logs.tolist()):
        name = version_name(version)
        writer = LakeWriter(lake, name)
        for dive, log_ratio in enumerate(of_version):
            identity = {
                "log": f"dive_{dive}",
                "log_sha256": f"{dive:064x}",
                "code_sha256": f"{version:064x}",
                "replay": f"{version:016x}{dive:016x}",
                "revision": name,
                "filter_verdict": Verdict.UNDECIDED,
                "started_at": f"2026-01-{version + 1:02d}T00:00:{dive:02d}Z",
            }
            rows = [_lake_row(row, math.exp(log_ratio), identity) for row in template]
            writer.add_rows(rows)
        writer.close()


def _lake_row(row: LakeRow, ratio: float, identity: Mapping[str, str]) -> LakeRow:
    row = msgspec.structs.replace(row, **identity)
    if row.quantity != POSITION:
        return row
    baseline = finite(row.baseline)
    # Both errors are independent, so that no proof shows that nothing differs.
    values = {"ratio": ratio, "value": ratio * baseline, "acts": 1.0, "role": Role.PRIMARY}
    return msgspec.structs.replace(row, **values)


def version_name(version: int) -> str:
    """Name a version, from 0."""
    return f"v{version}"


def history_steps(lake: Path) -> tuple[int, ...]:
    """Ask the tool which versions, from 0, changed the filter."""
    done = done_here("history", lake, "--format", "json", cwd=lake.parent)
    if done.returncode:
        raise RuntimeError(done.stderr)
    steps = json.loads(done.stdout)["tables"]["step"]
    return tuple(int(step["name"].removeprefix("v")) for step in steps)


@contextmanager
def classes_run_here() -> Iterator[None]:
    """Run classes of the user's in this process: words do not depend on it, and an interpreter takes far longer."""

    def run(
        processes: UserProcesses,
        _: str,
        dive: str,
        start: CandidateStart,
        *,
        new_process: bool = False,
    ) -> Solution:
        candidate = processes.settings.candidate or ""
        return solution_of_class(candidate, processes.file(dive), start)

    with patch.object(UserProcesses, "run", run):
        yield
