"""What is said of stored results: comparing them, reading them, and files that cannot be written."""

from pathlib import Path

from as_text import Cases, refusal, spoken
from made_reports import report, tables
from msgspec.structs import replace
from small_results import content, write

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.changes.comparison import compare_results
from insdvl_replay.changes.comparison_document import comparison_document
from insdvl_replay.core.dive_record import unique_names
from insdvl_replay.core.words import Reason
from insdvl_replay.document.text import as_markdown
from insdvl_replay.evaluation.answers import pooled_candidate
from insdvl_replay.evaluation.sentences import paragraph
from insdvl_replay.results.folder import result_file, result_folder
from insdvl_replay.results.stored_results import read_results
from insdvl_replay.show.dive import dive_document, track_fit_line
from insdvl_replay.show.result_files import run_log
from insdvl_replay.show.screens import dive_screen

COMPARED = (
    ["old", "worse", "--fail-on", "0%"],
    ["old", "lost", "--fail-on", "1000%"],
    ["old", "overconfident", "--fail-on", "50%"],
    ["old", "worse", "--fail-on", "better"],
    ["old", "worse", "--tolerance", "1e-3"],
    ["old", "worse", "--table", "improvment"],
    ["old", "worse", "--column", "rms"],
    ["old", "worse", "--dive", "dibe"],
    ["more", "old", "--fail-on", "0%"],
    ["old", "stranger"],
    ["old", "stranger", "--pair", "aided"],
    ["old", "stranger", "--pair", "aded=tuned"],
    ["more", "unrelated"],
    ["old", "absent"],
    ["old", "a" * 5000],
    ["old", "empty"],
    ["old", "study"],
    ["old"],
    ["old", "broken"],
    ["old", "list"],
    ["old", "future"],
)
# Several dives: what their paragraph is about, the ratio of position on each dive, and that of the level.
POOLED = (
    ("better", (0.79, 0.8, 0.81), 0.8),
    ("mixed", (0.79, 0.8, 0.81), 1.4),
    ("worse", (1.19, 1.2, 1.21), 0.8),
    ("equivalent", (1.0, 1.01, 0.99), 1.0),
    ("undecided", (0.8, 1.2, 1.0), 0.8),
    ("two dives", (0.8, 0.8), 0.8),
    ("one dive", (0.8,), 0.8),
)


def said_of_results(folder: Path) -> Cases:
    """Return what is said of comparisons, reports, and paths."""
    yield from of_comparisons(folder)
    yield from of_verdicts(folder)
    yield from of_reports()
    yield from of_files(folder)
    for name in ("*.mcap", "a\0b", "a" * 5000):
        yield f"dives of {name!r}", refusal(find_dives, [name], folder)
    yield "dives of one name", refusal(unique_names, [Path("/dives/x.mcap"), Path("/dives/x")])


def of_comparisons(folder: Path) -> Cases:
    for name, made in {
        "old": content(),
        "worse": content(rmse=0.44),
        "better": content(rmse=0.2),
        "lost": content(rmse=None),
        "overconfident": content(verdict="overconfident"),
        "stranger": content(filter="tuned"),
        "study": {"kind": "window", "tool": {"version": "0.1.0"}},
        "future": {"tool": {"version": "9.0"}, "log": {"title": "dive"}, "tables": {}},
        "form": content() | {"tables": 3},
        "list": [],
    }.items():
        write(folder / name, made)  # type: ignore[arg-type]
    for name, made in {
        "more/one": content("one"),
        "more/dive": content(),
        "unrelated/x": content("x"),
        "unrelated/y": content("y"),
    }.items():
        write(folder / name, made)
    twice, nameless = content(), content()
    twice["tables"]["improvement"] *= 2
    del nameless["tables"]["improvement"][1]["state"]
    write(folder / "twice", twice)
    write(folder / "nameless", nameless)
    (folder / "empty").mkdir()
    (folder / "broken").mkdir()
    (folder / "broken" / "report.json").write_text('{"tool": ')
    for arguments in COMPARED:
        said = spoken(folder, "compare", *arguments).splitlines()
        yield f"compare {' '.join(arguments)}", f"{said[0]}\n{said[-1]}"
    for sort in ("a", "b"):
        write(folder / "several" / sort / "dive", content())
    yield (
        "several results of one dive",
        refusal(compare_results, folder / "old", folder / "several"),
    )


def of_verdicts(folder: Path) -> Cases:
    """Return what is said first of two sets, and in brief."""
    for name, words in {"one": "worse", "two": "worse", "three": "better"}.items():
        write(
            folder / "before" / name,
            content(name, filter_verdict="better", prediction="confirmed"),
        )
        new = content(
            name,
            filter_verdict=words,
            prediction="undecided",
            rmse=0.5,
            window=5,
            sha256=f"another {name}",
        )
        new["config"] |= {f"key{number}": number for number in range(20)}
        write(folder / "after" / name, new)
    write(folder / "before" / "four", content("four"))
    changed, same = (
        compare_results(folder / "before", folder / name) for name in ("after", "before")
    )
    yield "in brief", as_markdown(comparison_document(changed))
    yield "nothing changed", as_markdown(comparison_document(same))


def of_reports() -> Cases:
    made = report()
    yield "a report in Markdown", as_markdown(dive_document(made))
    near, far, beyond = (
        replace(tables().credibility[0], quantity=name) for name in ("velocity", "north", "ba_x")
    )
    within = [replace(row, why=Reason.NEAR) for row in (near, far)]
    told = replace(tables(), credibility=[*within, replace(beyond, why=Reason.BEYOND_3_SD)])
    yield (
        "reasons in spite of an interval",
        "\n".join(
            line
            for line in as_markdown(dive_document(report(used=told))).splitlines()
            if "Verdicts that differ" in line
        ),
    )
    yield "the run's log", run_log(made)
    held_out = replace(
        made.tables.consistency[0], measurement="held_out_heading", used=0, rejected=2120
    )
    apart = replace(made, tables=replace(made.tables, consistency=[held_out]))
    yield "the run's log of a sensor that is held out", "\n".join(run_log(apart).splitlines()[-6:])
    yield "the track's fit", "\n".join(track_fit_line(made))
    lost = replace(
        made.filters["aided"], mean_improvement_pct=-66.9, mean_convergence_improvement_pct=-2.04
    )
    yield (
        "worse than before",
        as_markdown(dive_screen(replace(made, filters={"aided": lost}), "report.html")),
    )
    evidence = made.tables.evidence
    for name, ratios, level in POOLED:
        dives = [
            [
                replace(row, ratio=level if row.quantity == "level" else ratio)
                for row in evidence
                if row.ratio
            ]
            for ratio in ratios
        ]
        yield (
            f"dives together: {name}",
            paragraph(pooled_candidate("aided", "baseline", dives, len(dives), [6.7])),
        )


def of_files(folder: Path) -> Cases:
    (folder / "link").symlink_to("absent.toml")
    (folder / "to_folder").symlink_to("empty")
    (folder / "thesis").mkdir()
    (folder / "thesis" / "chapter1.tex").write_text("years of work")
    (folder / "taken.toml").touch()
    for name in ("link", "to_folder", "taken.toml", "a" * 300, "nowhere/new.toml"):
        yield f"a file {name}", refusal(write_text, folder / name)
    for name in ("thesis", "taken.toml", "a" * 300):
        yield f"a result in {name}", refusal(write_folder, folder / name)
    for name in ("study", "form", "nameless", "broken", "empty", "nowhere"):
        yield f"the result {name}", refusal(read_results, folder / name)
    later = folder / "later"
    (later / "one").mkdir(parents=True)
    (later / "one" / "report.json").touch()
    (later / "summary.csv").write_text("log,filter,status\none,,failed\n")
    yield "results of a run that failed", refusal(read_results, later)


def write_text(path: Path) -> None:
    with result_file(path, force=False) as file:
        file.write_text("new")


def write_folder(path: Path) -> None:
    with result_folder(path):
        pass
