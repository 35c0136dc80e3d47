"""docs/claims.md: what published numbers rest on, and what this tool says of filters that stand for them.

    python docs/generate/published_claims.py [FILTER]

The papers are in published_claims.toml. Each test is the command that the page shows, run on the logs of
../shared/data; its answer is kept in published_results.csv. Without these logs, or without the name of a filter that
has new results, the page is written from what is kept.
"""

import csv
import hashlib
import json
import math
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
from benchmark_page import FALSE_SHARE
from msgspec import Struct
from written import PROJECT, markdown_table, renewed

from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import FEWEST_DIVES, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import PooledRow, finite, share_text
from insdvl_replay.evaluation.answers import CandidateAnswer
from insdvl_replay.evaluation.interval import change_found, dives_needed, smallest_sign_p
from insdvl_replay.evaluation.sentences import ratio_text
from insdvl_replay.results.stored_results import read_reports
from insdvl_replay.show.answers import answers_of

PAGE = PROJECT / "docs" / "claims.md"
PAPERS = Path(__file__).with_suffix(".toml")
RESULTS = Path(__file__).with_name("published_results.csv")
COMMAND = "make claims"
PUBLIC = PROJECT / "benchmarks" / "public"
EXAMPLES = PROJECT / "examples" / "candidates"
BUILD = PROJECT / "build" / "claims"
DATA = PROJECT.parent / "shared" / "data"
# Scatters of the logarithm of the ratio over dives for which the page says what tracks find.
SCATTERS = (0.1, 0.2)
NOT_STATED = "not stated"
# The states whose sigma a class or a program reports, too.
SIX = ("dv_n", "dv_e", "dv_d", "phi_n", "phi_e", "phi_d")


class Test(Struct, frozen=True, kw_only=True):
    """A filter that stands for a paper, on data sets."""

    filter: str
    file: str  # of its settings, from benchmarks/public
    stands_for: str  # how near to the paper's it is
    data: tuple[str, ...]  # tags of dives.toml
    options: str = ""
    variables: str = ""  # of the environment, that its code needs

    @property
    def runs_code(self) -> bool:
        """Whether its settings name code."""
        settings = tomllib.loads((PUBLIC / self.file).read_text("utf-8"))
        mine = settings["filters"][self.filter]
        words = [*mine.get("aiding", ()), mine.get("candidate", ""), mine.get("noise_factors", "")]
        return any(":" in word for word in words)


class Paper(Struct, frozen=True, kw_only=True):
    """A published number and what it rests on."""

    name: str
    source: str
    link: str
    read: str  # what of it was read
    claim: str
    of: str  # what the number is of
    tracks: int | None = None  # None: the text that was read does not state it
    ratio: float | None = None  # None: the number is not of errors, or there is none
    test: tuple[Test, ...]


class Kept(Struct, frozen=True, kw_only=True):
    """The answer of a command: a line of the kept results."""

    command: str
    verdict: str
    quantity: str
    dives: int
    ratio: float | None
    low: float | None
    high: float | None
    acts: float | None
    sigma_pct: float | None  # how much smaller those of velocity and attitude are
    convergence: str
    reason: str


def load_papers() -> list[Paper]:
    """Return the papers, in the order of the page."""
    content = tomllib.loads(PAPERS.read_text("utf-8"))
    return msgspec.convert(content["paper"], list[Paper])


def load_results() -> dict[str, Kept]:
    """Return the kept answers, by command."""
    with RESULTS.open(encoding="utf-8", newline="") as file:
        rows = []
        for row in csv.DictReader(file):
            rows.append({name: value or None for name, value in row.items()})
    for row in rows:
        row.update({name: row[name] or "" for name in ("quantity", "convergence", "reason")})
    kept = msgspec.convert(rows, list[Kept], strict=False)
    return {row.command: row for row in kept}


def store_results(kept: Sequence[Kept]) -> None:
    """Write the kept answers."""
    with RESULTS.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, Kept.__struct_fields__, lineterminator="\n")
        writer.writeheader()
        for row in kept:
            values = msgspec.to_builtins(row)
            for name, value in values.items():
                if isinstance(value, float):
                    values[name] = f"{value:.6g}"
            writer.writerow(values)


def commands(papers: Sequence[Paper]) -> dict[str, tuple[Test, str]]:
    """Return each command of the page, with its test and its data set."""
    found = {}
    for paper in papers:
        for test in paper.test:
            for data_set in test.data:
                found[command_of(test, data_set)] = (test, data_set)
    return found


def command_of(test: Test, data_set: str) -> str:
    """Return what repeats a test, in benchmarks/public."""
    words = []
    if test.runs_code:
        words.append("PYTHONPATH=../../examples/candidates")
    if test.variables:
        words.append(test.variables)
    words.append(f"insdvl-replay run dives.toml#{data_set} -c {test.file}")
    if test.options:
        words.append(test.options)
    if test.runs_code:
        words.append("--allow-code")
    return " ".join(words)


# --- The runs.


def run_command(command: str, filter_: str, data: Path = DATA) -> Kept | None:
    """Run a command of the page on local logs; None if they are not there."""
    words = shlex.split(command)
    environment = dict(os.environ)
    while "=" in words[0]:
        name, _, value = words.pop(0).partition("=")
        environment[name] = value
    # Paths of the page are relative to the public folder.
    environment["PYTHONPATH"] = str(EXAMPLES)
    if "BEAMSNET_WEIGHTS" in environment:
        environment["BEAMSNET_WEIGHTS"] = str(data / "beamsnet" / "BeamsNetV2.pkl")
    _, _, data_set = words[2].partition("#")
    manifest = local_manifest(data_set, data)
    if manifest is None:
        return None
    output = BUILD / hashlib.sha256(command.encode()).hexdigest()[:12]
    shutil.rmtree(output, ignore_errors=True)
    program = Path(sys.executable).with_name("insdvl-replay")
    words[0] = str(program)
    words[2] = str(manifest)
    # A dive that cannot be replayed ends with 3, and has its reason in the page of the benchmark.
    subprocess.run(
        [*words, "-o", str(output), "--jobs", "2", "--quiet"],
        cwd=PUBLIC,
        env=environment,
        check=False,
    )
    found, _ = read_reports(output, Report)
    reports = [report for _, report in found]
    for answer in answers_of(reports):
        if answer.filter == filter_:
            return kept_of(command, answer, reports)
    raise ValueError(f"{command}: no answer for {filter_}")


def kept_of(command: str, answer: CandidateAnswer, reports: Sequence[Report]) -> Kept:
    """Return what is kept of an answer."""
    row = answer.decisive
    return Kept(
        command=command,
        verdict=str(answer.verdict),
        quantity=row.quantity if row is not None else "",
        dives=row.dives if row is not None else answer.dives,
        ratio=number_of(row, "ratio"),
        low=number_of(row, "low"),
        high=number_of(row, "high"),
        acts=number_of(row, "acts"),
        sigma_pct=known(sigma_change_pct(reports, answer.filter)),
        convergence=str(answer.settling),
        reason=answer.reason,
    )


def sigma_change_pct(reports: Sequence[Report], filter_: str) -> float:
    """Return how much smaller the last sigmas of velocity and attitude are: mean of the six, median of the dives."""
    means = []
    for report in reports:
        changes = []
        for row in report.tables.improvement:
            if row.filter == filter_ and row.state in SIX:
                changes.append(finite(row.improvement_pct))
        if changes:
            means.append(statistics.fmean(changes))
    finite_means = [mean for mean in means if math.isfinite(mean)]
    if not finite_means:
        return math.nan
    return statistics.median(finite_means)


def number_of(row: PooledRow | None, name: str) -> float | None:
    """Return a number of a row."""
    if row is None:
        return None
    return known(finite(getattr(row, name)))


def known(value: float) -> float | None:
    """Return a number, or None where it is not one."""
    if math.isfinite(value):
        return value
    return None


def local_manifest(data_set: str, data: Path = DATA) -> Path | None:
    """Write the dives of a data set with the paths of local logs; None if one is not there."""
    entries = tomllib.loads((PUBLIC / "dives.toml").read_text("utf-8"))["dive"]
    by_digest = {}
    for file in sorted(data.rglob("*")):
        if file.suffix in (".mcap", ".csv", ".bag"):
            by_digest[hashlib.sha256(file.read_bytes()).hexdigest()] = file
    lines = []
    for dive in entries:
        if data_set not in dive["tags"]:
            continue
        path = local_log(dive, by_digest)
        if path is None:
            return None
        found = {"path": str(path), "settings": str(PUBLIC / dive["settings"])}
        if "vehicle" in dive:
            found["vehicle"] = dive["vehicle"]
        lines.append("[[dive]]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in found.items()]
    manifest = BUILD / f"{data_set}.toml"
    manifest.parent.mkdir(parents=True, exist_ok=True)
    manifest.write_text("\n".join(lines), "utf-8")
    return manifest


def local_log(dive: dict[str, Any], by_digest: dict[str, Path]) -> Path | None:
    """Return the log of a dive, or the folder of its tables; None if it is not there."""
    if "files" not in dive:
        return by_digest.get(dive["sha256"])
    folder = BUILD / "tables" / dive["tags"][1]
    folder.mkdir(parents=True, exist_ok=True)
    for table in dive["files"]:
        if table["sha256"] not in by_digest:
            return None
        shutil.copy(by_digest[table["sha256"]], folder / table["name"])
    return folder


# --- The page.


def written(page: str, papers: Sequence[Paper], results: dict[str, Kept]) -> str:
    """docs/claims.md as it should be."""
    claims_header = (
        "paper",
        "claim",
        "number is of",
        "tracks",
        "smallest p",
        *(f"these tracks find, s = {scatter}" for scatter in SCATTERS),
        *(f"tracks needed, s = {scatter}" for scatter in SCATTERS),
        "what this tool says",
    )
    runs_header = (
        "paper",
        "filter",
        "stands for it as",
        "dives",
        "verdict",
        "quantity",
        "ratio",
        "interval",
        "acts",
        "sigma",
        "convergence",
        "command",
    )
    return renewed(
        page,
        {
            "claims": lambda: markdown_table(
                claims_header, [claim_row(paper, results) for paper in papers]
            ),
            "runs": lambda: markdown_table(runs_header, run_rows(papers, results)),
            "expected": lambda: false_words_line(results),
            "sources": lambda: markdown_table(
                ("paper", "source", "what was read"),
                [(paper.name, f"[{paper.source}]({paper.link})", paper.read) for paper in papers],
            ),
        },
        COMMAND,
    )


def claim_row(paper: Paper, results: dict[str, Kept]) -> tuple[str, ...]:
    """Return the row of a paper."""
    said = []
    for test in paper.test:
        for data_set in test.data:
            answer = results.get(command_of(test, data_set))
            if answer is not None:
                said.append(f"`{test.filter}`, {data_set}: {short_answer(answer)}")
    return (
        paper.name,
        paper.claim,
        paper.of,
        *checked_cells(paper),
        "<br>".join(said),
    )


def checked_cells(paper: Paper) -> tuple[str, ...]:
    """Return what follows from the number of tracks and from the claimed ratio alone."""
    return (
        tracks_text(paper),
        sign_p_text(paper),
        *(found_text(paper, scatter) for scatter in SCATTERS),
        *(needed_text(paper, scatter) for scatter in SCATTERS),
    )


def tracks_text(paper: Paper) -> str:
    """Return the number of tracks."""
    if paper.tracks is None:
        return NOT_STATED
    return str(paper.tracks)


def sign_p_text(paper: Paper) -> str:
    """Return the smallest two-sided p of a sign test with these tracks."""
    if paper.tracks is None:
        return "-"
    return f"{smallest_sign_p(paper.tracks):.2g}"


def found_text(paper: Paper, scatter: float) -> str:
    """Return the change that these tracks find in four of five cases."""
    if paper.tracks is None:
        return "-"
    if paper.tracks < FEWEST_DIVES:
        return "none"
    return f"{100.0 * (1.0 - change_found(scatter, paper.tracks)):.0f} %"


def needed_text(paper: Paper, scatter: float) -> str:
    """Return how many tracks find the claimed ratio in four of five cases."""
    if paper.ratio is None:
        return "-"
    needed = dives_needed(scatter, paper.ratio)
    if needed is None:
        return "-"
    return str(needed)


def short_answer(answer: Kept) -> str:
    """Return the verdict with its number."""
    text = answer.verdict
    if answer.quantity:
        text += f", {label(answer.quantity)} {ratio_text(answer.ratio)} ({interval_of(answer)})"
    if answer.acts is not None:
        text += f", acts {share_text(answer.acts)}"
    return text


def interval_of(answer: Kept) -> str:
    """Return the interval; a dash where there is none."""
    if answer.low is None or answer.high is None:
        return "-"
    return f"{ratio_text(answer.low)} .. {ratio_text(answer.high)}"


def run_rows(papers: Sequence[Paper], results: dict[str, Kept]) -> Iterator[tuple[str, ...]]:
    """Yield a row for each command that was run."""
    for paper in papers:
        for test in paper.test:
            for data_set in test.data:
                command = command_of(test, data_set)
                if command in results:
                    answer = results[command]
                    yield (
                        paper.name,
                        f"`{test.filter}`",
                        test.stands_for,
                        f"{data_set}, {answer.dives}",
                        " ".join(filter(None, (answer.verdict, bracketed(answer.reason)))),
                        label(answer.quantity) if answer.quantity else "-",
                        ratio_text(answer.ratio),
                        interval_of(answer),
                        share_text(answer.acts),
                        sigma_text(answer.sigma_pct),
                        answer.convergence or "-",
                        f"`{command}`",
                    )


def false_words_line(results: dict[str, Kept]) -> str:
    """Say how many wrong words the rows are expected to have at most."""
    judged = sum(answer.low is not None for answer in results.values())
    share = f"{100.0 * FALSE_SHARE:.0f} %"
    return (
        f"An interval gives the word of {counted(judged, 'row')}. If no filter differed from its baseline, at most "
        f"{share} of them would be called better or worse ([measured](verdict.md#how-often-the-rule-is-right)). "
        f"So at most {FALSE_SHARE * judged:.1f} wrong words are expected here."
    )


def bracketed(text: str) -> str:
    """Return a reason in brackets."""
    if not text:
        return ""
    return f"({text})"


def sigma_text(change_pct: float | None) -> str:
    """Return by how much sigma changes."""
    if change_pct is None:
        return "-"
    if abs(change_pct) < 0.05:
        return "same"
    word = "smaller" if change_pct >= 0.0 else "larger"
    return f"{abs(change_pct):.1f} % {word}"


def main() -> None:
    """Run what is asked for, and write the page."""
    papers = load_papers()
    wanted = commands(papers)
    results = {}
    if RESULTS.exists():
        results = load_results()
    for command, (test, _) in wanted.items():
        is_asked = test.filter in sys.argv[1:] or (not sys.argv[1:] and command not in results)
        if is_asked:
            kept = run_command(command, test.filter)
            if kept is None:
                sys.stderr.write(f"its logs are not here: {command}\n")
                continue
            results[command] = kept
            # A long run that is stopped keeps what it has.
            store_results([results[known] for known in wanted if known in results])
    PAGE.write_text(written(PAGE.read_text("utf-8"), papers, results), "utf-8")


if __name__ == "__main__":
    main()
