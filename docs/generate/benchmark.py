"""The parts of docs/benchmark.md that the program writes, and its picture: candidates on the public dives.

    python docs/generate/benchmark.py

A cell is a candidate on the dives of a data set. A dive is replayed only if its log, its settings or the program have
changed. Logs in ../shared/data are known by their digests; others are fetched.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import msgspec
from written import PROJECT, markdown_table, renewed

from insdvl_replay.batch.jobs import ReplayJob, ReplayOptions, known_reports, replay_jobs
from insdvl_replay.batch.manifest import manifest_dives
from insdvl_replay.batch.workers import local_pool
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_record import LOG_SUFFIXES
from insdvl_replay.core.errors import LogError, UserError, counted
from insdvl_replay.core.quantities import label
from insdvl_replay.core.result import Report
from insdvl_replay.core.tables import PooledRow, finite
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import AGAINST, Piece, left_undecided, shown_interval
from insdvl_replay.show import answers
from insdvl_replay.show.answers import AnyAnswer, evidence_text, interval_text, ratio_text, spoken_rows
from insdvl_replay.show.dives import NO_EVIDENCE
from insdvl_replay.show.first_screen import ForestRow, forest
from insdvl_replay.show.plot import style_sheet

PAGE = PROJECT / "docs" / "benchmark.md"
PICTURE = PAGE.with_suffix(".svg")
QUOTED = {PROJECT / "README.md": "docs/benchmark.md", PROJECT / "docs" / "reproduction.md": "benchmark.md"}
"""Pages that quote what is found of the paper's method, with the link to the benchmark."""
COMMAND = "make benchmark"
EXAMPLES = PROJECT / "examples" / "candidates"
ALL = "all dives"
"""Stands for the dives of all data sets."""
METHODS = ("published", "windowed")
"""The paper's model, and the same predicted over the window of the velocities."""
BEST_FIRST = [*map(Verdict, ("better", "equivalent", "undecided", "mixed", "worse", "not evaluated"))]
WIDTH, ABOVE = 860, 30
"""Of the picture and above each plot, in pixels."""
JOBS = 2


@dataclass(frozen=True)
class Place:
    """The folders of a benchmark."""

    public: Path = PROJECT / "benchmarks" / "public"  # dives.toml, settings and candidates
    build: Path = PROJECT / "build" / "benchmark"
    data: Path = PROJECT.parent / "shared" / "data"  # logs that need not be fetched

    @property
    def dives(self) -> list[dict[str, Any]]:
        """The entries of dives.toml; the first tag of a dive is its data set, the second its name."""
        return list(tomllib.loads((self.public / "dives.toml").read_text("utf-8"))["dive"])


@dataclass
class Cell:
    """A candidate on the dives of a data set, or on all dives."""

    candidate: str
    data_set: str
    file: str  # of the candidate, in the public folder
    variables: str = ""  # of the environment, that its code needs
    code: bool = False  # it runs code
    reports: dict[str, Report] = field(default_factory=dict)  # by dive
    reasons: dict[str, str] = field(default_factory=dict)  # by dive that could not be replayed

    @property
    def is_planted(self) -> bool:
        """Its verdict is known beforehand."""
        return self.candidate.startswith("planted_")

    @cached_property
    def answer(self) -> AnyAnswer | None:
        """The verdict; None without evidence."""
        found = [found for found in answers.answers_of([*self.reports.values()]) if found.filter == self.candidate]
        known = [one for one in found if spoken_rows(one) or one.verdict == Verdict.NOT_EVALUATED]
        return known[0] if known else None

    @property
    def rows(self) -> list[Piece]:
        """The evidence that decided, or could have: a row, or two of a mixed verdict."""
        return spoken_rows(self.answer) if self.answer else []

    @property
    def rank(self) -> tuple[int, float, str]:
        """By verdict, then by the first evidence, which is the same for all; cells without a verdict come last."""
        if self.answer is None:
            return len(BEST_FIRST), 0.0, self.candidate
        ratio = next((finite(row.ratio) for row in self.answer.known), 0.0)
        return BEST_FIRST.index(self.answer.verdict), ratio, self.candidate

    @property
    def dives(self) -> int:
        """The number of dives with this evidence, else of those that were replayed."""
        return next((row.dives for row in self.rows if isinstance(row, PooledRow)), len(self.reports))

    @property
    def digest(self) -> str:
        """Of the logs and the resolved settings."""
        settings = partial(msgspec.json.encode, order="deterministic")
        sides = [[report.log.sha256, settings(report.config).decode()] for report in self.reports.values()]
        text = settings(sorted(sides)).decode().replace(str(PROJECT), "")
        return hashlib.sha256(text.encode()).hexdigest()[:12] if sides else ""

    @property
    def command(self) -> str:
        """What repeats it, in the public folder."""
        tag, allowed = "" if self.data_set == ALL else f"#{self.data_set}", " --allow-code" if self.code else ""
        return f"{self.variables}insdvl-replay run dives.toml{tag} -c {self.file}{allowed}"

    @property
    def reason(self) -> str:
        """Why it has no verdict, or no decision."""
        if self.answer is None:
            return NO_EVIDENCE if self.reports else "; ".join(self.without)
        return (
            self.answer.reason
            if self.answer.verdict == Verdict.NOT_EVALUATED
            else answers.reason_undecided(self.answer)
        )

    @property
    def without(self) -> list[str]:
        """The reasons of the dives that could not be replayed, each once."""
        dives: dict[str, list[str]] = {}
        for dive, reason in self.reasons.items():
            dives.setdefault(reason, []).append(dive)
        is_all = len(dives) == 1 and not self.reports
        return [reason if is_all else f"{', '.join(names)}: {reason}" for reason, names in dives.items()]


# --- The replays.


def prepare(place: Place) -> None:
    """Set what the code of candidates needs, and compile the program in C++ where there is a compiler."""
    sys.path.insert(0, str(EXAMPLES))  # of the processes that replay
    os.environ["BEAMSNET_WEIGHTS"] = str(place.data / "beamsnet" / "BeamsNetV2.pkl")
    source, program = EXAMPLES / "error_state_filter.cpp", place.build / "error_state_filter"
    is_new = program.is_file() and program.stat().st_mtime >= source.stat().st_mtime
    if not is_new and (compiler := shutil.which("c++")) is not None:
        place.build.mkdir(parents=True, exist_ok=True)
        exact = ("-O2", "-std=c++17", "-ffp-contract=off")
        subprocess.run([compiler, *exact, "-o", str(program), str(source)], check=True)


def build(place: Place) -> list[Cell]:
    """Replay each candidate on each dive; return the cells over all dives, then those of each data set."""
    logs = [path for path in sorted(place.data.rglob("*")) if path.suffix in LOG_SUFFIXES]
    local = {hashlib.sha256(log.read_bytes()).hexdigest(): log for log in logs}
    data_sets: dict[str, list[dict[str, Any]]] = {}
    for dive in place.dives:
        data_sets.setdefault(dive["tags"][0], []).append(dive)
    cells = [cell for name, dives in data_sets.items() for cell in replayed(name, dives, local, place)]
    # A candidate in the folder of a data set is for this data set alone.
    general = dict.fromkeys(cell.candidate for cell in cells if cell.file.count("/") == 1)
    return [*(over_all([cell for cell in cells if cell.candidate == name]) for name in general), *cells]


def replayed(data_set: str, dives: Sequence[Mapping[str, Any]], local: Mapping[str, Path], place: Place) -> list[Cell]:
    """Replay the dives of a data set through each candidate."""
    folder = place.public / "candidates"
    files = {file.stem: file for part in (folder, folder / data_set) for file in sorted(part.glob("*.toml"))}
    cells = {name: Cell(name, data_set, file.relative_to(place.public).as_posix()) for name, file in files.items()}
    arm_m = load_config(file=place.public / dives[0]["settings"]).dvl.lever_arm_m
    os.environ["BEAMSNET_ARM_M"] = ",".join(f"{length:.3f}" for length in arm_m)
    jobs, owners = list[ReplayJob](), list[tuple[Cell, str]]()
    for dive in dives:
        name, settings = dive["tags"][1], place.public / dive["settings"]
        for candidate, cell in cells.items():
            try:
                log = log_of(dive, local, place)
                config = load_config(file=[settings, files[candidate]], allow_code=True)
            except UserError as error:
                cell.reasons[name] = plain_reason(error, name)
                continue
            cell.code = bool(config.code)
            if "beamsnet:BeamsNet" in config.code:
                cell.variables = f"BEAMSNET_ARM_M={os.environ['BEAMSNET_ARM_M']} "
            target = place.build / candidate / data_set / name
            jobs.append(ReplayJob((log,), log, target, ReplayOptions(config, histories=False), replaces=True))
            owners.append((cell, name))
    known = known_reports(jobs, force=True)
    is_code = any(cell.code for cell in cells.values())
    pool = local_pool(JOBS, runs_code=is_code) if len(known) < len(jobs) else None
    for (cell, name), outcome in zip(owners, replay_jobs(jobs, known, pool), strict=True):
        if isinstance(outcome.result, Report):
            cell.reports[name] = outcome.result
        else:
            cell.reasons[name] = plain_reason(outcome.result, name)
    return [*cells.values()]


def log_of(dive: Mapping[str, Any], local: Mapping[str, Path], place: Place) -> Path:
    """Return the log of a dive: one that is there, else one that is fetched."""
    if (log := local.get(dive["sha256"])) is not None:
        return log
    [found] = manifest_dives(place.public / "dives.toml", dive["tags"][1])
    if found.error is not None:
        raise found.error
    if not found.path.exists():
        raise LogError("is not published in this form")
    return found.path


def plain_reason(error: Exception, dive: str) -> str:
    """Return the first clause of an error, without its dive and without the folders of this machine."""
    text = error.what if isinstance(error, UserError) else str(error)
    for folder in (PROJECT, PROJECT.parent):
        text = text.replace(f"{folder}/", "")
    return " ".join(text.removeprefix(f"{dive}: ").partition(";")[0].split())


def over_all(cells: Sequence[Cell]) -> Cell:
    """Put the dives of all data sets together."""
    found = Cell(cells[0].candidate, ALL, cells[0].file, code=any(cell.code for cell in cells))
    for cell in cells:
        found.reports |= cell.reports
        found.reasons |= cell.reasons
    variables = {cell.variables for cell in cells if cell.reports}
    found.variables = variables.pop() if len(variables) == 1 else ""
    return found


# --- The page.


def written(page: str, cells: Sequence[Cell], dives: Sequence[Mapping[str, Any]]) -> str:
    """docs/benchmark.md as it should be."""
    candidates = by_data_set(cell for cell in cells if not cell.is_planted)
    parts: dict[str, Callable[[], str]] = {
        "finding": lambda: finding(candidates),
        "all": lambda: table(candidates[ALL]),
        "sets": lambda: "\n\n".join(f"### {name}\n\n{table(candidates[name])}" for name in [*candidates][1:]),
        "checks": lambda: checks(by_data_set(cells)),
        "dives": lambda: dives_table(dives),
    }
    return renewed(page, parts, COMMAND)


def by_data_set(cells: Iterable[Cell]) -> dict[str, list[Cell]]:
    """Return the cells of each data set, the best first."""
    found: dict[str, list[Cell]] = {}
    for cell in cells:
        found.setdefault(cell.data_set, []).append(cell)
    return {name: sorted(of_set, key=lambda cell: cell.rank) for name, of_set in found.items()}


def table(cells: Sequence[Cell]) -> str:
    """Return cells, and below those of a data set the dives that some of them lack."""
    header = ("filter", "evidence", "ratio", "95 % interval", "n", "verdict", "reason", "digest", "command")
    some = [cell for cell in cells if cell.reports and cell.data_set != ALL]
    lacking = [f"- `{cell.candidate}` without {why}" for cell in some for why in cell.without]
    return "\n".join([markdown_table(header, map(row_of, cells)), *(["", *lacking] if lacking else [])])


def row_of(cell: Cell) -> tuple[str, ...]:
    """Return a row of a table; the evidence of a mixed verdict is on two lines."""
    columns = (lambda row: label(row.quantity), lambda row: ratio_text(row.ratio), interval_text)
    evidence = ("<br>".join(map(column, cell.rows)) for column in columns)
    verdict = cell.answer.verdict if cell.answer else "missing"
    digest, command = (f"`{text}`" if text else "" for text in (cell.digest, cell.command))
    return f"`{cell.candidate}`", *evidence, counted(cell.dives, "dive"), verdict, cell.reason, digest, command


def checks(cells: Mapping[str, Sequence[Cell]]) -> str:
    """Say how the planted candidates came out, and which of all filters are first and last."""
    parts = []
    for name, ranked in cells.items():
        evaluated = [f"`{cell.candidate}`" for cell in ranked if cell.rows]
        places = f" First of {len(evaluated)} filters: {evaluated[0]}. Last: {evaluated[-1]}." if evaluated else ""
        parts += [f"**{name}**.{places}", table([cell for cell in ranked if cell.is_planted])]
    return "\n\n".join(parts)


def dives_table(dives: Sequence[Mapping[str, Any]]) -> str:
    """List the dives, with a link where there is one."""
    logs = [f"[log]({dive['url']})" if "url" in dive else "converted" for dive in dives]
    rows = [(*dive["tags"], log, dive["licence"], dive["faults"]) for dive, log in zip(dives, logs, strict=True)]
    return markdown_table(("data set", "dive", "log", "licence", "known faults"), rows)


def finding(cells: Mapping[str, Sequence[Cell]]) -> str:
    """Say what the benchmark finds of the paper's method, what it leaves undecided, and on which dives."""
    lines = [quote(cells), ""]
    for method in METHODS:
        known = [cell for of_set in cells.values() for cell in of_set if cell.candidate == method and cell.rows]
        over_all, *of_sets = known
        numbers = ", ".join(f"{cell.dives} of {cell.data_set}" for cell in of_sets)
        counts = answers.verdict_counts(method, [report for cell in of_sets for report in cell.reports.values()])
        found = over_all.answer
        undecided = left_undecided(found.verdict, found.known).replace(";", ". All dives,") if found else ""
        lines.append(f"- `{method}`: {numbers}. Dive by dive: {counts}{undecided}.")
    return "\n".join(lines)


def quote(cells: Mapping[str, Sequence[Cell]], link: str = "") -> str:
    """Say it in two sentences, with a link to the page on other pages."""
    found = {cell.candidate: cell for cell in cells[ALL]}
    answered = [(cell, cell.answer) for cell in (found[name] for name in METHODS) if cell.answer]
    published, windowed = (f"{AGAINST[answer.verdict]} none: {evidence_text(answer)}" for _, answer in answered)
    dives = f"[public dives]({link})" if link else "public dives"
    return (
        f"On {answered[0][0].dives} {dives} with calibrated settings, acceleration aiding as published {published}. "
        f"Predicted over the window of the velocities, it {windowed}."
    )


def picture(cells: Mapping[str, Sequence[Cell]]) -> bytes:
    """Draw a forest plot over all dives, and one for each data set with evidence."""
    drawn, top = list[str](), 0
    for name, ranked in cells.items():
        rows = []
        for cell in (cell for cell in ranked if cell.rows):
            row, verdict = cell.rows[0], cell.answer.verdict if cell.answer else ""
            text = f"{ratio_text(row.ratio)} {verdict}, {label(row.quantity)}"
            rows.append(ForestRow(cell.candidate, row.ratio, shown_interval(row), verdict, text))
        plot = re.search(r'<svg( width="100%" height="(\d+)">.*</svg>)', forest("", rows))
        if rows and plot is not None:
            drawn.append(f'<text x="8" y="{top + 18}">{name}</text><svg y="{top + ABOVE}"{plot[1]}')
            top += ABOVE + int(plot[2])
    size = f'width="{WIDTH}" height="{top}" viewBox="0 0 {WIDTH} {top}"'
    style = f"<title>Ratio of errors, with its 95 % interval</title>\n<style>\n{style_sheet()}</style>"
    paper = '<rect width="100%" height="100%" fill="var(--paper)"/>'
    body = "\n".join([style, paper, '<g class="forest">', *drawn, "</g>"])
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">\n{body}\n</svg>\n'.encode()


def main() -> None:
    """Write the page, its picture and the quotes."""
    place = Place()
    prepare(place)
    cells = build(place)
    PAGE.write_text(written(PAGE.read_text("utf-8"), cells, place.dives), "utf-8")
    candidates = by_data_set(cell for cell in cells if not cell.is_planted)
    PICTURE.write_bytes(picture(candidates))
    for page, link in QUOTED.items():
        parts = {"benchmark": partial(quote, candidates, link)}
        page.write_text(renewed(page.read_text("utf-8"), parts, COMMAND), "utf-8")


if __name__ == "__main__":
    main()
