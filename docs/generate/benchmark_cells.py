"""The cells of the public benchmark: each candidate on the dives of each data set, and the replays behind them.

A dive is replayed only if its log, its settings or the program have changed.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import msgspec
from benchmark_dives import Place, data_set_of, name_of
from written import PROJECT

from insdvl_replay.batch.jobs import ReplayJob, ReplayOptions, known_reports
from insdvl_replay.batch.runs import replay_jobs
from insdvl_replay.batch.workers import local_pool
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError, UserError
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import PooledRow
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import CandidateAnswer
from insdvl_replay.show import answers

EXAMPLES = PROJECT / "examples" / "candidates"
WORDS = tomllib.loads((PROJECT / "benchmarks" / "public" / "words.toml").read_text("utf-8"))
PLANTED: Mapping[str, str] = WORDS["planted"]
# The copy of the baseline also shows what the dives of a data set can show.
WITH_ASSAY = "planted_copy"
JOBS = 2


@dataclass
class Cell:
    """A candidate on the dives of a data set."""

    candidate: str
    data_set: str
    file: str  # of the candidate, in the public folder
    variables: str = ""  # of the environment, that its code needs
    code: bool = False  # it runs code
    reports: dict[str, Report] = field(default_factory=dict)  # by dive
    errors: dict[str, str] = field(default_factory=dict)  # by dive that could not be replayed

    @property
    def is_planted(self) -> bool:
        """Whether it is a check of the benchmark itself."""
        return self.candidate in PLANTED

    @cached_property
    def answer(self) -> CandidateAnswer | None:
        """The verdict; None if there is none, and nothing that speaks against one."""
        for found in answers.answers_of([*self.reports.values()]):
            is_known = bool(found.known) or found.verdict == Verdict.NOT_EVALUATED
            if found.filter == self.candidate and is_known:
                return found
        return None

    @property
    def has_evidence(self) -> bool:
        """Whether a quantity decides."""
        return self.decisive is not None

    @property
    def decisive(self) -> PooledRow | None:
        """The row that decides."""
        if self.answer is None or self.answer.verdict == Verdict.NOT_EVALUATED:
            return None
        return self.answer.decisive

    @property
    def rows(self) -> list[PooledRow]:
        """The row that decides, and those that speak against it."""
        if self.answer is None or self.decisive is None:
            return []
        return [self.decisive, *self.answer.warnings]

    @property
    def digest(self) -> str:
        """Of the logs and the resolved settings."""
        settings = partial(msgspec.json.encode, order="deterministic")
        sides = []
        for report in self.reports.values():
            sides.append([report.log.sha256, settings(report.config).decode()])
        if not sides:
            return ""
        text = settings(sorted(sides)).decode().replace(str(PROJECT), "")
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    @property
    def command(self) -> str:
        """What repeats it, in the public folder."""
        allowed = " --allow-code" if self.code else ""
        assay = " --assay" if self.candidate == WITH_ASSAY else ""
        options = f"-c {self.file}{allowed}{assay}"
        return f"{self.variables}insdvl-replay run dives.toml#{self.data_set} {options}"

    @property
    def reasons(self) -> dict[str, list[str]]:
        """Why it is not evaluated, with the dives on which that is so."""
        why = dict(self.errors)
        for dive, report in self.reports.items():
            why[dive] = answers.answer_on_dive(report, self.candidate).reason
        found: dict[str, list[str]] = {}
        for dive, text in why.items():
            plain = plain_reason(text, dive)
            if plain:
                found.setdefault(plain, []).append(dive)
        return joined_reasons(found)


def joined_reasons(reasons: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Join reasons that differ in one number alone: it becomes a range, such as ``has 23 to 25 s``."""
    numbered = re.compile(WORDS["numbered"]["pattern"])
    alike: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for text, dives in reasons.items():
        before, number, after = text, "", ""
        found = numbered.search(text)
        if found is not None:
            before, number, after = text[: found.start(1)], found[1], text[found.end(1) :]
        for dive in dives:
            alike.setdefault((before, after), []).append((number, dive))
    joined = {}
    for (before, after), found_on in alike.items():
        numbers = sorted({number for number, _ in found_on}, key=lambda text: float(text or 0.0))
        span = numbers[0]
        if len(numbers) > 1:
            span = f"{numbers[0]} to {numbers[-1]}"
        joined[f"{before}{span}{after}"] = [dive for _, dive in found_on]
    return joined


def plain_reason(text: str, dive: str) -> str:
    """Return an error without its dive, without the folders of this machine, and in plain words."""
    for folder in (PROJECT, PROJECT.parent):
        text = text.replace(f"{folder}/", "")
    text = " ".join(text.removeprefix(f"{dive}: ").split())
    for pattern, words in WORDS["reasons"].items():
        text = re.sub(pattern, words, text)
    return text


def common_reason(cells: Iterable[Cell]) -> str:
    """Return the most common reason why the cells of a data set are empty."""
    counts = Counter[str]()
    for cell in cells:
        for why, dives in cell.reasons.items():
            counts[why] += len(dives)
    if not counts:
        return "no evidence"
    return counts.most_common(1)[0][0]


# --- The replays.


def prepare(place: Place) -> None:
    """Set what the code of candidates needs, and compile the program in C++ where there is a compiler."""
    sys.path.insert(0, str(EXAMPLES))  # of the processes that replay
    weights = place.data / "beamsnet" / "BeamsNetV2.pkl"
    os.environ.setdefault("BEAMSNET_WEIGHTS", str(weights))
    source = EXAMPLES / "error_state_filter.cpp"
    program = place.build / "error_state_filter"
    compiler = shutil.which("c++")
    is_new = program.is_file() and program.stat().st_mtime >= source.stat().st_mtime
    if is_new or compiler is None:
        return
    place.build.mkdir(parents=True, exist_ok=True)
    flags = ["-O2", "-std=c++17", "-ffp-contract=off"]
    subprocess.run([compiler, *flags, "-o", program, source], check=True)


def build(place: Place) -> list[Cell]:
    """Replay each candidate on each dive; return the cells of each data set."""
    cells = []
    for name, dives in place.data_sets.items():
        cells += replayed(name, dives, place)
    if not cells:
        raise ConfigError(f"benchmarks/public/candidates/{place.candidates}.toml: does not exist")
    return cells


def replayed(data_set: str, dives: Sequence[Mapping[str, Any]], place: Place) -> list[Cell]:
    """Replay the dives of a data set through each candidate."""
    files = candidate_files(data_set, place)
    cells = {}
    for name, file in files.items():
        cells[name] = Cell(name, data_set, file.relative_to(place.public).as_posix())
    arm_m = load_config(file=place.public / dives[0]["settings"]).dvl.lever_arm_m
    os.environ["BEAMSNET_ARM_M"] = ",".join(f"{length:.3f}" for length in arm_m)
    jobs = list[ReplayJob]()
    owners = list[tuple[Cell, str]]()
    for dive in dives:
        for candidate, cell in cells.items():
            try:
                job = job_of(cell, dive, files[candidate], place)
            except UserError as error:
                cell.errors[name_of(dive)] = error.what
                continue
            jobs.append(job)
            owners.append((cell, name_of(dive)))
    known = known_reports(jobs, force=True)
    pool = None
    if len(known) < len(jobs):
        pool = local_pool(JOBS, runs_code=any(cell.code for cell in cells.values()))
    outcomes = replay_jobs(jobs, known, pool)
    for (cell, name), outcome in zip(owners, outcomes, strict=True):
        if isinstance(outcome.result, Report):
            cell.reports[name] = outcome.result
        else:
            cell.errors[name] = getattr(outcome.result, "what", str(outcome.result))
    return [*cells.values()]


def candidate_files(data_set: str, place: Place) -> dict[str, Path]:
    """Return the files of the candidates of a data set, by name; those in a folder of its name are for it alone."""
    folder = place.public / "candidates"
    files = {}
    for part in (folder, folder / data_set):
        for file in sorted(part.glob(f"{place.candidates}.toml")):
            files[file.stem] = file
    return files


def job_of(cell: Cell, dive: Mapping[str, Any], file: Path, place: Place) -> ReplayJob:
    """Return the replay of a dive through a candidate, and note in its cell what its command needs.

    Raises
    ------
    UserError
        The dive cannot be had, or the settings are wrong.
    """
    name = name_of(dive)
    log = place.logs[name]
    if isinstance(log, UserError):
        raise log
    config = load_config(file=[place.public / dive["settings"], file], allow_code=True)
    if cell.candidate not in config.filters:
        raise ConfigError(
            f"{cell.file} has no filter {cell.candidate}; file and filter must have the same name"
        )
    cell.code = bool(config.code)
    cell.variables = ""
    if any(":" in word for word in config.code):
        cell.variables = "PYTHONPATH=../../examples/candidates "
    if "beamsnet:BeamsNet" in config.code:
        arm_m = os.environ["BEAMSNET_ARM_M"]
        cell.variables += f"BEAMSNET_WEIGHTS=data/BeamsNetV2.pkl BEAMSNET_ARM_M={arm_m} "
    is_assayed = cell.candidate == WITH_ASSAY
    options = ReplayOptions(config, histories=False, assay=is_assayed)
    target = place.build / cell.candidate / data_set_of(dive) / name
    job = ReplayJob((log,), log, target, options, replaces=True)
    return replace(job, vehicle=dive.get("vehicle", ""))
