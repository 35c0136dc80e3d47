"""The page of one dive, and the same document in other formats."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import msgspec

from insdvl_replay.core.config import Config
from insdvl_replay.core.result import (
    PAGE,
    PRINTED,
    PRINTED_LONG,
    Callout,
    Code,
    DisplayTable,
    Figure,
    Heading,
    Html,
    Only,
    Panel,
    Part,
    Report,
    Sentences,
    Title,
    flattened,
)
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.verdicts import SHARED, trust_sentence
from insdvl_replay.show.alone import line_alone
from insdvl_replay.show.answers import TONES, answer_on_dive, has_reference
from insdvl_replay.show.dive import (
    NO_REFERENCE,
    SPECIFIED,
    heading,
    headline_table,
    replayed,
    tables_of,
    track_fit_line,
)
from insdvl_replay.show.document import notes_table, percent, table_of
from insdvl_replay.show.first_screen import evidence_forest, first_screen, section
from insdvl_replay.show.page import HOW_TO_READ, captioned, facts, page, pictures, settings_details

MEANING: Final = "Background of panels over time: grey where the vehicle turns, ochre where the DVL has no velocity."
# Rows of a forest plot, by the number of candidates; with more candidates the fewest rows.
_MOST_ROWS: Final = {1: 14, 2: 10}
_FEWEST_ROWS: Final = 8


def dive_document(
    report: Report, panels: Sequence[Panel] = (), figures: Sequence[Part] = (), last: Sequence[Part] = ()
) -> list[Part]:
    """Return a report as a document: what was measured, then what the filters predict.

    ``panels`` are next to the verdicts, ``figures`` after the evidence, ``last`` after all tables.
    """
    found = tables_of(report)

    def named(*names: str) -> list[DisplayTable]:
        return [table for (name, _), table in found.items() if name in names]

    by_candidate, outage, references = named("evidence"), named("outage"), named("drift", "track_fit", "jumps")
    gains, names = ("improvement", "convergence", "reference_error"), [*report.filters] or [report.baseline]
    tables = [found[kind, name] for name in names for kind in gains if (kind, name) in found]
    tables += named("consistency", "innovations", "credibility")
    verdicts = (Callout(candidate.sentence, TONES.get(candidate.verdict, "")) for candidate in report.filters.values())
    headline = list(headline_table(report, "This run: position error and drift without DVL", SPECIFIED))
    return [
        Only(PRINTED, (Title(heading(report)), *verdicts, *headline)),
        Only(PAGE, (Title(replayed(report)), *_first_screen(report, panels, headline), *by_candidate)),
        *([] if report.filters else [line_alone(report)]),
        *track_fit_line(report),
        *([] if has_reference(report) else [NO_REFERENCE]),
        Only(PRINTED, (*by_candidate, *outage)),
        Only(PRINTED_LONG, tuple(references)),
        *figures,
        Heading("Tables"),
        Only(PAGE, tuple(replace(table, folded=True) for table in (*outage, *references, *tables))),
        Only(PRINTED, (*tables, Sentences(closing_lines(report)))),
        *last,
    ]


def _first_screen(report: Report, panels: Sequence[Panel], headline: Sequence[DisplayTable]) -> Iterator[Part]:
    """Yield the verdicts with their evidence, and next to them the panels and the headline."""
    sections = [dive_section(report, name) for name in report.filters]
    runs = "Errors over time: median and range of the runs from all starts. " if len(panels) > 1 else ""
    caption = f"{runs}{HOW_TO_READ} {MEANING}" if panels else ""
    yield first_screen(sections, caption, pictures(panels), headline)
    if any(candidate.sentence.endswith(SHARED) for candidate in report.filters.values()):
        yield SHARED


def dive_section(report: Report, name: str, title: str = "Evidence") -> str:
    """Return the section of a candidate on one dive."""
    answer = answer_on_dive(report, name)
    if answer.verdict == Verdict.NOT_EVALUATED:
        return section(answer, [f"{answer.reason}. Settle this first."])
    sentences = [answer.measured, answer.predicted, trust_sentence(report.tables, name, report.baseline)]
    most = _MOST_ROWS.get(len(report.filters), _FEWEST_ROWS)
    return section(answer, sentences, [evidence_forest(title, answer, most)])


def closing_lines(report: Report) -> tuple[str, ...]:
    """Return a line for each candidate with its mean predicted improvement."""
    consistency_words = "reference error and consistency" if has_reference(report) else "outage and consistency"
    return tuple(
        f"{name}: predicted by its own covariance, mean of nine states: "
        f"{percent(means.mean_improvement_pct)} smaller sigma, "
        f"{percent(means.mean_convergence_improvement_pct)} faster convergence "
        f"(a filter without any change has {percent(means.mean_convergence_unchanged_pct)}; by the nearest approach "
        f"{percent(means.mean_nearest_approach_improvement_pct)}). To check it, see {consistency_words}."
        for name, means in report.filters.items()
        if means.verdict != Verdict.NOT_EVALUATED
    )


def dive_page(report: Report, first: Sequence[Panel], figures: Sequence[Figure], strips: str, settings: str) -> bytes:
    """Return the page of a replay; the same replay gives the same bytes."""
    sensors = captioned("Data coverage", "Height: share of the time with valid samples. A dip is a gap.", strips)
    log = report.log
    origin = {
        "log": log.name,
        "SHA-256 of the log": log.sha256 or "none",
        "span on the log's clock": f"{log.start_ns} to {log.end_ns} ns",
        "tool": f"{report.tool.name} {report.tool.version}",
        "packages": ", ".join(f"{name} {version}" for name, version in report.versions.items()),
    }
    channels = table_of(
        "Channels of the log",
        log.channels,
        (
            ("topic", "l", "topic"),
            ("type", "l", "type_name"),
            ("encoding", "l", "encoding"),
            ("role", "l", lambda channel: channel.role or "not used"),
            ("messages", "r", "messages"),
        ),
    )
    return page(
        dive_document(
            report,
            first,
            [Heading("Figures"), *figures, Html(sensors)],
            [
                Heading("Notes"),
                notes_table(report.notes),
                Heading("Provenance"),
                facts(origin),
                channels,
                Code(changed_settings(report.config), "toml"),
                settings_details(settings),
            ],
        )
    )


def changed_settings(config: Mapping[str, Any]) -> str:
    """Write the settings that are not the defaults, a line each."""
    usual = dict(flattened(msgspec.to_builtins(Config())))
    lines = [f"{key} = {json.dumps(value)}" for key, value in flattened(config) if usual.get(key, ...) != value]
    return "\n".join(["# settings that differ from the defaults", *lines] if lines else ["# all settings are defaults"])
