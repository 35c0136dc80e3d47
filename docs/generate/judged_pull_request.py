"""The parts of docs/pull_request.md that the program writes: the changes of a pull request on the Snapir's dives.

    python docs/generate/judged_pull_request.py DIVES [RESULTS]

DIVES are a folder of logs, or a manifest with settings of its own such as benchmarks/public/dives.toml#snapir. Without
RESULTS the dives are replayed, for some minutes. With them, which an earlier call wrote, only the page is.
"""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from written import PROJECT, markdown_table, renewed

from insdvl_replay.changes.answer import Answer
from insdvl_replay.changes.comparison import Comparison, compare_results
from insdvl_replay.core.quantities import label
from insdvl_replay.core.report import StoredReport
from insdvl_replay.core.tables import PooledRow
from insdvl_replay.evaluation.sentences import interval_text, ratio_text
from insdvl_replay.results.stored_results import read_results

PAGE = PROJECT / "docs" / "pull_request.md"
EXAMPLE = PROJECT / "examples" / "pull_request"
RESULTS = PROJECT / "build" / "pull_request"
COMMAND = "make pull_request"
# The class of each change, by the filter that it changes.
CHANGES = {
    "jacobian": "JacobianMended",
    "order": "OrderMended",
    "both": "BothMended",
    "no_decay": "DecayRemoved",
}
# The last step, in a run of its own: the filter before it is the last one of the changes.
TUNED = {"tuned": "Tuned"}
BUILT_IN = ""  # the name of the baseline in tables
# Each change on top of the one before it: the second filter is compared with the first.
STEPS = (("jacobian", "both"), ("both", "no_decay"))
SHOWN = ("position", "heading", "outage_30s")
VERDICT = ("before", "after", "ratio", "interval", "smaller on", "verdict")
JOBS = "2"


def command(dives: str, settings: str, changes: Mapping[str, str], results: Path) -> list[str]:
    """Return the arguments that replay the dives before and after changes of the filters of a settings file."""
    words = ["run", dives]
    if "#" not in dives:
        words += ["-c", str(PROJECT / "examples" / "snapir.toml")]
    words += ["-c", str(EXAMPLE / settings), "--allow-code"]
    for name, kind in changes.items():
        words += ["--against", f"filters.{name}.candidate=pull_request:{kind}"]
    return [*words, "-o", str(results), "--jobs", JOBS, "--force", "-q"]


def replay(dives: str, results: Path) -> None:
    """Replay the dives before and after the changes, and before and after the last step."""
    environment = os.environ | {"PYTHONPATH": f"{EXAMPLE}{os.pathsep}{PROJECT}"}
    for words in (
        command(dives, "filters.toml", CHANGES, results / "changes"),
        command(dives, "tuned.toml", TUNED, results / "tuned"),
    ):
        subprocess.run(
            [sys.executable, "-m", "insdvl_replay", *words], env=environment, check=True
        )


def written(page: str, results: Path) -> str:
    """Return the page as it should be."""
    changes = results / "changes"
    comparison = compare_results(changes / "before", changes / "after")
    parts = {
        "answers": lambda: answers(comparison),
        "verdicts": lambda: verdicts(comparison),
        "steps": lambda: steps(results),
        "dives": lambda: dives_table(results),
    }
    return renewed(page, parts, COMMAND)


def answer_of(comparison: Comparison, name: str) -> Answer:
    """Return the answer on a filter."""
    [found] = [answer for answer in comparison.answers if answer.filter == name]
    return found


def answers(comparison: Comparison) -> str:
    """Return what the command prints of the changed filters."""
    lines = [answer_of(comparison, name).sentence for name in CHANGES]
    return "\n".join(["```text", *lines, "```"])


def verdicts(comparison: Comparison) -> str:
    """Return the table of the changes: errors before and after, ratio, interval, verdict."""
    rows = []
    for name in CHANGES:
        answer = answer_of(comparison, name)
        pooled = {row.quantity: row for row in answer.rows}
        for quantity in SHOWN:
            if quantity in pooled:
                names = (f"`{name}`", label(quantity))
                rows.append((*names, *verdict_cells(answer, pooled[quantity])))
    return markdown_table(("filter", "quantity", *VERDICT), rows)


def steps(results: Path) -> str:
    """Return the table of each change on top of the one before it: the position error."""
    after = results / "changes" / "after"
    rows = []
    for old, new in STEPS:
        # A filter that is not asked about gets a name that the other side lacks.
        comparison = compare_results(after, after, filter_pairs={old: new, new: f"{new}_before"})
        rows.append(step_row(old, new, answer_of(comparison, new)))
    tuned = compare_results(results / "tuned" / "before", results / "tuned" / "after")
    rows.append(step_row("no_decay", "tuned", answer_of(tuned, "tuned")))
    return markdown_table(("from", "to", *VERDICT), rows)


def step_row(old: str, new: str, answer: Answer) -> tuple[str, ...]:
    """Return a row of the table of steps, of the quantity that decides."""
    [row] = [row for row in answer.rows if row.quantity == answer.primary]
    return (f"`{old}`", f"`{new}`", *verdict_cells(answer, row))


def verdict_cells(answer: Answer, row: PooledRow) -> tuple[str, ...]:
    """Return errors before and after, ratio, interval, dives and word; a word that decides is bold."""
    word = str(row.verdict)
    if row.quantity == answer.primary:
        word = f"**{answer.verdict}**"
    return (
        f"{rounded(row.baseline)} {row.unit}",
        f"{rounded(row.value)} {row.unit}",
        ratio_text(row.ratio),
        interval_text(row),
        f"{row.dives_won} of {row.dives}",
        word,
    )


def dives_table(results: Path) -> str:
    """Return the rms horizontal position error of each filter on each dive, m."""
    before = errors_by_dive(results / "changes" / "before")
    after = errors_by_dive(results / "changes" / "after")
    tuned = errors_by_dive(results / "tuned" / "after")
    first = next(iter(CHANGES))
    rows = []
    for dive, now_m in sorted(after.items()):
        own = [before[dive][first], *(now_m[name] for name in CHANGES)]
        own += [tuned[dive]["tuned"], now_m[BUILT_IN]]
        rows.append((dive, *map(rounded, own)))
    names = (f"`{name}`" for name in (*CHANGES, *TUNED))
    return markdown_table(("dive", "as it is", *names, "built-in"), rows)


def errors_by_dive(folder: Path) -> dict[str, dict[str, float]]:
    """Return the rms horizontal position errors of a folder of results, by dive and filter."""
    results, _ = read_results(folder)
    return {result.name: errors_m(result.report) for result in results}


def errors_m(report: StoredReport) -> dict[str, float]:
    """Return the rms horizontal position error by filter."""
    found = {}
    for row in report.tables["reference_error"]:
        if row["quantity"] == "position_h":
            found[str(row["filter"])] = float(str(row["rmse"]))
            found[BUILT_IN] = float(str(row["baseline_rmse"]))
    return found


def rounded(value: float | None) -> str:
    """Write an error with two decimals, a large one with one."""
    if value is None:
        return "-"
    if value < 10.0:
        return f"{value:.2f}"
    return f"{value:.1f}"


def main(dives: str, results: str = "") -> None:
    """Replay, and write the page; without the dives it stays as it is."""
    folder = Path(results or RESULTS)
    if not results:
        if not Path(dives.partition("#")[0]).exists():
            sys.exit(f"{dives} does not exist, so docs/pull_request.md stays as it is")
        replay(dives, folder)
    PAGE.write_text(written(PAGE.read_text("utf-8"), folder), "utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
