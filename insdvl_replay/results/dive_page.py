"""The page of one dive: what to think of it, the tables, the figures, what was lost, and where it all comes from."""

from collections.abc import Iterator, Sequence
from typing import Final

from insdvl_replay.core.words import Gain
from insdvl_replay.report.display_table import ShownTable
from insdvl_replay.report.page import Heading, Html, Lead, LinkedTable, Part, page
from insdvl_replay.report.page_parts import facts, losses, settings_details
from insdvl_replay.report.plots.panel import Figure
from insdvl_replay.results.dive_sentences import replayed
from insdvl_replay.results.dive_tables import glance_table, shown_tables
from insdvl_replay.results.figures.improvement import improvement_bars
from insdvl_replay.results.json_report import Report

_TONES: Final[dict[str, str]] = {
    Gain.BORNE_OUT: "good",
    Gain.NOT_BORNE_OUT: "bad",
    Gain.WORSE: "bad",
    Gain.NOT_JUDGED: "bad",
}


def dive_page(report: Report, figures: Sequence[Figure], strips: str, settings: str) -> bytes:
    """Write the page of a replay.

    Parameters
    ----------
    report : Report
    figures : sequence of Figure
    strips : str
        HTML from `figures.coverage`.
    settings : str
        The resolved configuration as TOML.

    Returns
    -------
    bytes
        The same replay gives the same bytes.
    """
    coverage = (
        "<figure><figcaption><strong>What they had to go on: sensors and gaps</strong><span>A strip is as high as the "
        "share of the time that valid samples cover; where it falls, something is missing.</span></figcaption>"
        f"{strips}</figure>"
    )
    parts: list[Part] = [
        *_first_screen(report),
        Heading("Tables"),
        *shown_tables(report),
        Heading("Figures"),
        Html(_bars(report)),
        *figures,
        Html(coverage),
        Heading("What was lost or assumed"),
        losses(report.notes),
        Heading("Provenance"),
        *_provenance(report, settings),
    ]
    return page(replayed(report), parts)


def _first_screen(report: Report) -> Iterator[Part]:
    """Say what to think of each candidate, and lay the words and numbers behind it beside each other."""
    for candidate in report.filters.values():
        yield Lead(candidate.verdict, _TONES.get(candidate.improvement, ""))
    if report.filters:
        yield LinkedTable(glance_table(report), ())


def _bars(report: Report) -> str:
    bars = "".join(improvement_bars(report, name) for name in report.filters)
    return (
        "<figure><figcaption><strong>Believed against actual: how much smaller the errors are</strong><span>Upper "
        "bars, blue: what a filter believes to have gained, by its own covariance. Lower bars: what it has gained "
        "against the reference.</span></figcaption>"
        f'<div class="tables">{bars}</div></figure>'
    )


def _provenance(report: Report, settings: str) -> Iterator[Part]:
    yield facts(
        {
            "log": report.log.name,
            "SHA-256 of the log": report.log.sha256 or "none",
            "span on the log's clock": f"{report.log.start_ns} to {report.log.end_ns} ns",
            "tool": f"{report.tool.name} {report.tool.version}",
            "with": ", ".join(f"{name} {version}" for name, version in report.versions.items()),
        }
    )
    yield ShownTable(
        "Channels of the log",
        ("topic", "type", "encoding", "role", "messages"),
        "llllr",
        tuple(
            (channel.topic, channel.type_name, channel.encoding, channel.role or "not used", str(channel.messages))
            for channel in report.log.channels
        ),
    )
    yield settings_details(settings)
