"""The parts of docs/benchmark.md that the program writes, and its picture: candidates on the public dives.

    python docs/generate/benchmark.py [NAME]

With a name, its rows are printed. A cell is a candidate on the dives of a data set. A dive is replayed only if its log,
its settings or the program have changed. Logs in ../shared/data are known by their digests; others are fetched.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import msgspec
from written import PROJECT, markdown_table, renewed

from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.jobs import ReplayJob, ReplayOptions, known_reports
from insdvl_replay.batch.manifest import fetch_dives, manifest_dives
from insdvl_replay.batch.runs import replay_jobs
from insdvl_replay.batch.workers import local_pool
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_record import LOG_SUFFIXES
from insdvl_replay.core.errors import ConfigError, LogError, UserError, counted, listed
from insdvl_replay.core.quantities import label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import PooledRow, finite, share_text
from insdvl_replay.core.words import ReasonCode, Verdict
from insdvl_replay.document.looks import style_sheet
from insdvl_replay.evaluation.answers import BAD, GOOD, CandidateAnswer
from insdvl_replay.evaluation.sentences import (
    headline,
    interval_text,
    plan_line,
    ratio_text,
    ratio_with_interval,
    why_undecided,
)
from insdvl_replay.show import answers
from insdvl_replay.show.dives import NO_EVIDENCE
from insdvl_replay.show.first_screen import ForestRow, forest, interval_ends

PAGE = PROJECT / "docs" / "benchmark.md"
PICTURE = PAGE.with_suffix(".svg")
# The pages that quote what is found of the paper's method.
QUOTING = (PROJECT / "README.md", PROJECT / "docs" / "reproduction.md")
COMMAND = "make benchmark"
EXAMPLES = PROJECT / "examples" / "candidates"
ALL = "all dives"  # of all data sets
# The candidates that are the paper's method, in words.
METHODS = {"published": "published", "windowed_fitted": "windowed with fitted noise"}
WORDS = tomllib.loads((PROJECT / "benchmarks" / "public" / "words.toml").read_text("utf-8"))
NUMBERS = [
    "no",
    "one",
    "two",
    "three",
    "four",
    "five",
    "six",
    "seven",
    "eight",
    "nine",
    "ten",
    "eleven",
    "twelve",
]
HEADER = (
    "filter",
    "evidence",
    "ratio",
    "interval",
    "acts",
    "n",
    "verdict",
    "reason",
    "digest",
    "command",
)
BEST_FIRST = [*Verdict]
TOO_FEW = (ReasonCode.ONE_DIVE, ReasonCode.FEW_DIVES)
# Pixels: of the picture, and above each plot.
WIDTH = 860
ABOVE = 30
JOBS = 2


@dataclass(frozen=True)
class Place:
    """The folders of a benchmark."""

    public: Path = PROJECT / "benchmarks" / "public"  # dives.toml, settings and candidates
    build: Path = PROJECT / "build" / "benchmark"
    data: Path = PROJECT.parent / "shared" / "data"  # logs that need not be fetched
    candidates: str = "*"  # pattern of their names

    @property
    def dives(self) -> list[dict[str, Any]]:
        """The entries of dives.toml; the first tag of a dive is its data set, the second its name."""
        entries = tomllib.loads((self.public / "dives.toml").read_text("utf-8"))["dive"]
        dives = [{"licence": "unknown", "faults": "unknown"} | dive for dive in entries]
        names = Counter(dive["tags"][1] for dive in dives)
        if same := [name for name, count in names.items() if count > 1]:
            raise ConfigError(f"dives.toml: more than one dive has the name {listed(same)}")
        return dives

    @cached_property
    def logs(self) -> dict[str, Path | UserError]:
        """The log of each dive, by name: one that is there, else one that is fetched, else why there is none."""
        files = [path for path in sorted(self.data.rglob("*")) if path.suffix in LOG_SUFFIXES]
        local = {hashlib.sha256(log.read_bytes()).hexdigest(): log for log in files}
        dives = manifest_dives(self.public / "dives.toml")
        found = fetch_dives(
            [FoundDive(local[dive.sha256]) if dive.sha256 in local else dive for dive in dives]
        )
        nowhere = LogError("its log is not published in this form")
        logs = [dive.error or (dive.path if dive.path.exists() else nowhere) for dive in found]
        return dict(zip((dive["tags"][1] for dive in self.dives), logs, strict=True))


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
    def verdict(self) -> str:
        """The word."""
        return self.answer.verdict if self.answer else "missing"

    @cached_property
    def answer(self) -> CandidateAnswer | None:
        """The verdict; None without evidence."""
        found = [
            found
            for found in answers.answers_of([*self.reports.values()])
            if found.filter == self.candidate
        ]
        known = [one for one in found if one.known or one.verdict == Verdict.NOT_EVALUATED]
        return known[0] if known else None

    @property
    def rows(self) -> list[PooledRow]:
        """The row that decides, and those that speak against it."""
        if (
            self.answer is None
            or self.answer.verdict == Verdict.NOT_EVALUATED
            or self.answer.decisive is None
        ):
            return []
        return [self.answer.decisive, *self.answer.warnings]

    @property
    def rank(self) -> tuple[int, float, str]:
        """By verdict, then by the ratio that decides; cells without a verdict come last."""
        if self.answer is None:
            return len(BEST_FIRST), 0.0, self.candidate
        ratio = next((finite(row.ratio) for row in self.rows), 0.0)
        return BEST_FIRST.index(self.answer.verdict), ratio, self.candidate

    @property
    def dives(self) -> int:
        """The number of dives with this evidence, else of those that were replayed."""
        return next((row.dives for row in self.rows), len(self.reports))

    @property
    def digest(self) -> str:
        """Of the logs and the resolved settings."""
        settings = partial(msgspec.json.encode, order="deterministic")
        sides = [
            [report.log.sha256, settings(report.config).decode()]
            for report in self.reports.values()
        ]
        text = settings(sorted(sides)).decode().replace(str(PROJECT), "")
        return hashlib.sha256(text.encode()).hexdigest()[:12] if sides else ""

    @property
    def command(self) -> str:
        """What repeats it, in the public folder."""
        tag = "" if self.data_set == ALL else f"#{self.data_set}"
        allowed = " --allow-code" if self.code else ""
        return f"{self.variables}insdvl-replay run dives.toml{tag} -c {self.file}{allowed}"

    @property
    def reason(self) -> str:
        """Why it has no verdict, or no decision; then on how many dives it is not evaluated, and why."""
        dives: dict[str, list[str]] = {}
        words = {
            dive: answers.answer_on_dive(report, self.candidate).reason
            for dive, report in self.reports.items()
        }
        for dive, why in (words | self.reasons).items():
            dives.setdefault(plain_reason(why, dive), []).append(dive)
        pieces = []
        if self.answer is not None:
            pieces.append(why_undecided(self.answer))
        elif self.reports:
            pieces.append(NO_EVIDENCE)
        for why, names in dives.items():
            part = f" on {len(names)} of {counted(len(words | self.reasons), 'dive')}"
            named = "" if self.data_set == ALL else f" ({', '.join(names)})"
            pieces += (
                [f"not evaluated{part}{named}: {why}" if len(dives) > 1 else why] if why else []
            )
        return "; ".join(filter(None, pieces))


# --- The replays.


def prepare(place: Place) -> None:
    """Set what the code of candidates needs, and compile the program in C++ where there is a compiler."""
    sys.path.insert(0, str(EXAMPLES))  # of the processes that replay
    os.environ.setdefault("BEAMSNET_WEIGHTS", str(place.data / "beamsnet" / "BeamsNetV2.pkl"))
    source = EXAMPLES / "error_state_filter.cpp"
    program = place.build / "error_state_filter"
    is_new = program.is_file() and program.stat().st_mtime >= source.stat().st_mtime
    if not is_new and (compiler := shutil.which("c++")) is not None:
        place.build.mkdir(parents=True, exist_ok=True)
        subprocess.run(
            [compiler, "-O2", "-std=c++17", "-ffp-contract=off", "-o", program, source], check=True
        )


def build(place: Place) -> list[Cell]:
    """Replay each candidate on each dive; return the cells over all dives, then those of each data set."""
    data_sets: dict[str, list[dict[str, Any]]] = {}
    for dive in place.dives:
        data_sets.setdefault(dive["tags"][0], []).append(dive)
    cells = [cell for name, dives in data_sets.items() for cell in replayed(name, dives, place)]
    if not cells:
        raise ConfigError(f"benchmarks/public/candidates/{place.candidates}.toml: does not exist")
    # A candidate in the folder of a data set is for this data set alone.
    general = dict.fromkeys(cell.candidate for cell in cells if cell.file.count("/") == 1)
    return [
        *(over_all([cell for cell in cells if cell.candidate == name]) for name in general),
        *cells,
    ]


def replayed(data_set: str, dives: Sequence[Mapping[str, Any]], place: Place) -> list[Cell]:
    """Replay the dives of a data set through each candidate."""
    folder = place.public / "candidates"
    found = [
        file
        for part in (folder, folder / data_set)
        for file in sorted(part.glob(f"{place.candidates}.toml"))
    ]
    files = {file.stem: file for file in found}
    cells = {
        name: Cell(name, data_set, file.relative_to(place.public).as_posix())
        for name, file in files.items()
    }
    arm_m = load_config(file=place.public / dives[0]["settings"]).dvl.lever_arm_m
    os.environ["BEAMSNET_ARM_M"] = ",".join(f"{length:.3f}" for length in arm_m)
    jobs = list[ReplayJob]()
    owners = list[tuple[Cell, str]]()
    for dive in dives:
        name = dive["tags"][1]
        settings = place.public / dive["settings"]
        for candidate, cell in cells.items():
            try:
                if isinstance(log := place.logs[name], UserError):
                    raise log
                config = load_config(file=[settings, files[candidate]], allow_code=True)
                if candidate not in config.filters:
                    raise ConfigError(
                        f"{cell.file} has no filter {candidate}; file and filter must have the same name"
                    )
            except UserError as error:
                cell.reasons[name] = error.what
                continue
            cell.code = bool(config.code)
            is_class = any(":" in word for word in config.code)
            cell.variables = "PYTHONPATH=../../examples/candidates " if is_class else ""
            if "beamsnet:BeamsNet" in config.code:
                cell.variables += f"BEAMSNET_WEIGHTS=data/BeamsNetV2.pkl BEAMSNET_ARM_M={os.environ['BEAMSNET_ARM_M']} "
            target = place.build / candidate / data_set / name
            jobs.append(
                ReplayJob(
                    (log,), log, target, ReplayOptions(config, histories=False), replaces=True
                )
            )
            owners.append((cell, name))
    known = known_reports(jobs, force=True)
    pool = (
        local_pool(JOBS, runs_code=any(cell.code for cell in cells.values()))
        if len(known) < len(jobs)
        else None
    )
    for (cell, name), outcome in zip(owners, replay_jobs(jobs, known, pool), strict=True):
        if isinstance(outcome.result, Report):
            cell.reports[name] = outcome.result
        else:
            cell.reasons[name] = getattr(outcome.result, "what", str(outcome.result))
    return [*cells.values()]


def plain_reason(text: str, dive: str) -> str:
    """Return an error without its dive, without the folders of this machine, and in plain words."""
    for folder in (PROJECT, PROJECT.parent):
        text = text.replace(f"{folder}/", "")
    text = " ".join(text.removeprefix(f"{dive}: ").split())
    for pattern, words in WORDS["reasons"].items():
        text = re.sub(pattern, words, text)
    return text


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
    candidates = by_data_set(cell for cell in cells if cell.candidate not in WORDS["planted"])
    tables = {
        name: markdown_table(HEADER, map(row_of, of_set)) for name, of_set in candidates.items()
    }
    parts: dict[str, Callable[[], str]] = {
        "finding": lambda: finding(candidates),
        "all": lambda: tables[ALL],
        "sets": lambda: "\n\n".join(
            f"### {name}\n\n{tables[name]}" for name in tables if name != ALL
        ),
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


def row_of(cell: Cell) -> tuple[str, ...]:
    """Return a row of a table; each row of the evidence is on a line of its own."""
    columns = (
        lambda row: label(row.quantity),
        lambda row: ratio_text(row.ratio),
        interval_text,
        lambda row: share_text(row.acts),
    )
    evidence = ("<br>".join(map(column, cell.rows)) for column in columns)
    digest, command = (f"`{text}`" if text else "" for text in (cell.digest, cell.command))
    return (
        f"`{cell.candidate}`",
        *evidence,
        counted(cell.dives, "dive"),
        cell.verdict,
        cell.reason,
        digest,
        command,
    )


def checks(cells: Mapping[str, Sequence[Cell]]) -> str:
    """Say how the planted candidates came out: first is only what is better, last only what is worse."""
    parts = []
    for name, ranked in cells.items():
        known = [cell.candidate for cell in ranked if cell.rows]
        rows = list[tuple[str, ...]]()
        for cell in (cell for cell in ranked if cell.candidate in WORDS["planted"]):
            is_first = cell.candidate in known[:1]
            is_last = cell.candidate in known[-1:]
            place = (
                ", first"
                if is_first and cell.verdict in GOOD
                else ", last"
                if is_last and cell.verdict in BAD
                else ""
            )
            word = f"{cell.verdict}{place}"
            is_known = cell.answer is not None and cell.answer.undecided not in TOO_FEW
            must = (
                "-"
                if not is_known
                else "yes"
                if re.match(WORDS["planted"][cell.candidate], word)
                else "no"
            )
            rows.append((*row_of(cell)[:6], word, must, *row_of(cell)[7:]))
        title = f"**{name}**, {counted(len(known), 'filter')} with evidence"
        parts += [title, markdown_table((*HEADER[:7], "as it must", *HEADER[7:]), rows)]
    return "\n\n".join(parts)


def dives_table(dives: Sequence[Mapping[str, Any]]) -> str:
    """List the dives, with a link where there is one."""
    logs = [f"[log]({dive['url']})" if "url" in dive else "no link" for dive in dives]
    rows = [
        (*dive["tags"], log, dive["licence"], dive["faults"])
        for dive, log in zip(dives, logs, strict=True)
    ]
    return markdown_table(("data set", "dive", "log", "licence", "known faults"), rows)


def of_methods(cells: Sequence[Cell]) -> list[tuple[Cell, CandidateAnswer]]:
    """Return the cells of the paper's method with evidence, and their answers."""
    found = {cell.candidate: (cell, cell.answer) for cell in cells if cell.rows and cell.answer}
    return [found[name] for name in METHODS if name in found]


def finding(cells: Mapping[str, Sequence[Cell]]) -> str:
    """Say what the benchmark finds of the paper's method, over all dives."""
    lines = [quote(cells), ""]
    for cell, answer in of_methods(cells[ALL]):
        said = ". ".join(filter(None, (headline(answer), plan_line(answer).rstrip("."))))
        lines.append(f"- `{cell.candidate}`, {counted(cell.dives, 'dive')}: {said}.")
    return "\n".join(lines)


def quote(cells: Mapping[str, Sequence[Cell]]) -> str:
    """Say of each data set what the paper's method changes, by how much, and the verdict."""
    sentences = list[str]()
    for name in (name for name in cells if name != ALL):
        found = of_methods(cells[name])
        if not found:
            continue
        count = max(cell.dives for cell, _ in found)
        noun = (
            WORDS["dives"].get(name, f"{{}} of {name}").format("dive" if count == 1 else "dives")
        )
        number = NUMBERS[count] if count < len(NUMBERS) else count
        place = f"On {number} {noun}, "
        for cell, answer in found:
            row = cell.rows[0]
            method = METHODS[cell.candidate]
            begun = f"{place}{method}" if place else f"{method[:1].upper()}{method[1:]}"
            sentences.append(
                f"{begun} is {answer.verdict}: {ratio_with_interval(row)}, moved by {share_text(row.acts)}."
            )
            place = ""
    return " ".join(sentences)


def picture(cells: Mapping[str, Sequence[Cell]]) -> bytes:
    """Draw a forest plot over all dives, and one for each data set with evidence."""
    drawn = list[str]()
    top = 0
    for name, ranked in cells.items():
        rows = []
        for cell in (cell for cell in ranked if cell.rows):
            row = cell.rows[0]
            text = (
                f"{ratio_text(cell.rows[0].ratio)} {cell.verdict}, {label(cell.rows[0].quantity)}"
            )
            rows.append(
                ForestRow(cell.candidate, row.ratio, interval_ends(row), cell.verdict, text)
            )
        plot = re.search(r'<svg( width="100%" height="(\d+)">.*</svg>)', forest("", rows))
        if rows and plot is not None:
            drawn.append(
                f'<text x="8" y="{top + 18}">{name}</text><svg y="{top + ABOVE}"{plot[1]}'
            )
            top += ABOVE + int(plot[2])
    size = f'width="{WIDTH}" height="{top}" viewBox="0 0 {WIDTH} {top}"'
    style = f"<title>Ratio of errors, with its interval over dives</title>\n<style>\n{style_sheet()}</style>"
    paper = '<rect width="100%" height="100%" fill="var(--paper)"/>'
    body = "\n".join([style, paper, '<g class="forest">', *drawn, "</g>"])
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">\n{body}\n</svg>\n'.encode()


def main(candidates: str = "*") -> None:
    """Write the page, its picture and the quotes; of one candidate, or where dives are missing, print the rows."""
    place = Place(candidates=candidates)
    page = PAGE.read_text("utf-8")
    prepare(place)
    try:
        cells = build(place)
    except UserError as error:
        sys.exit(f"error: {error}")
    missing = [
        name
        for name, log in place.logs.items()
        if isinstance(log, UserError) and f"| {name} |" in page
    ]
    if candidates != "*" or missing:
        new = [
            cell for cell in cells if candidates != "*" or f"| `{cell.candidate}` |" not in page
        ]
        why = (
            f", since {counted(len(missing), 'dive')} of it cannot be had: {listed(missing)}"
            if missing
            else ""
        )
        sys.stdout.write(
            f"{markdown_table(HEADER, map(row_of, new or cells))}\nThe page stays as it is{why}.\n"
        )
        return
    PAGE.write_text(written(page, cells, place.dives), "utf-8")
    shown = by_data_set(cell for cell in cells if cell.candidate not in WORDS["planted"])
    PICTURE.write_bytes(picture(shown))
    for file in QUOTING:
        file.write_text(
            renewed(file.read_text("utf-8"), {"benchmark": partial(quote, shown)}, COMMAND),
            "utf-8",
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
