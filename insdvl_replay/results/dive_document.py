"""What is shown of one dive: what to think of it, its tables; on its page also figures, losses and provenance."""

import json
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any, Final

import msgspec

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import visible
from insdvl_replay.core.quantities import label
from insdvl_replay.core.stored_report import flattened
from insdvl_replay.core.tables import Candidate
from insdvl_replay.core.words import Belief, Judgement
from insdvl_replay.report.document import (
    PAGE,
    PRINTED,
    PRINTED_LONG,
    Callout,
    Code,
    DisplayTable,
    Facts,
    Folded,
    Heading,
    Html,
    LinkedTable,
    Only,
    Part,
    Pictures,
    Sentences,
    Title,
    losses,
    percent,
    settings_details,
)
from insdvl_replay.report.page import page
from insdvl_replay.report.plots.panel import Figure, Panel
from insdvl_replay.results.dive_tables import (
    NO_REFERENCE,
    SPECIFIED,
    TONES,
    evidence_tables,
    filter_tables,
    glance_table,
    has_reference,
    headline_table,
    reference_tables,
    track_fit_line,
)
from insdvl_replay.results.json_report import Report

_LOUD: Final = (Judgement.WORSE, Judgement.NOT_JUDGED)
_MEASURED_BY: Final = {"phi_n": "level", "phi_e": "level", "phi_d": "heading"}
"""States of which a piece of evidence tells, and which."""
MEANING: Final = "Shaded behind panels over time: the vehicle turns (grey), or the DVL has no velocity (ochre)."
_MOST_GAINS: Final = 2
_FULL_PCT: Final = 100.0
"""Longer bars end at the edge; the number beside them says it all."""


def dive_document(
    report: Report, first: Sequence[Part] = (), figures: Sequence[Part] = (), behind: Sequence[Part] = ()
) -> list[Part]:
    """Lay out a report: what was measured, then what the filters say of themselves.

    Parameters
    ----------
    first : sequence of Part
        What stands between the verdict and the evidence.
    figures : sequence of Part
        What stands behind the evidence.
    behind : sequence of Part
        What stands behind all tables.
    """
    evidence, tables = list(evidence_tables(report)), list(filter_tables(report))
    glance = [glance_table(report)] if report.filters else []
    references = list(reference_tables(report))
    of_candidates = [table for table in evidence if table.title.startswith("Evidence")]
    folded = [Folded(table.title, (table,)) for table in (*evidence[len(of_candidates) :], *references, *tables)]
    return [
        Only(PRINTED, (Title(heading(report)),)),
        Only(PAGE, (Title(_replayed(report)),)),
        *(Callout(candidate.verdict, TONES.get(candidate.improvement, "")) for candidate in report.filters.values()),
        *headline_table(report, "This run: position error and drift without DVL", SPECIFIED),
        *first,
        Only(PAGE, tuple(of_candidates)),
        *track_fit_line(report),
        *([] if has_reference(report) else [NO_REFERENCE]),
        Only(PRINTED, tuple(evidence)),
        Only(PRINTED_LONG, tuple(references)),
        *figures,
        Heading("Tables"),
        *(LinkedTable(table, ()) for table in glance),
        Only(PAGE, tuple(folded)),
        Only(PRINTED, tuple(tables)),
        Only(PRINTED, (Sentences(closing_lines(report)),)),
        *behind,
    ]


def dive_page(report: Report, first: Sequence[Panel], figures: Sequence[Figure], strips: str, settings: str) -> bytes:
    """Write the page of a replay; the same replay gives the same bytes."""
    caption = "Lines are the middle of the runs from all starts, shaded where the runs lie. " if len(first) > 1 else ""
    opening = [Pictures((*first, *_bars(report)), f"{caption}A click on a picture shows it alone. {MEANING}")]
    drawn: list[Part] = [
        Heading("Figures"),
        *figures,
        _figure(
            "What they had to go on: sensors and gaps",
            "A strip is as high as the share of the time that valid samples cover; where it falls, something is "
            "missing.",
            strips,
        ),
    ]
    behind: list[Part] = [
        Heading("What was lost or assumed"),
        losses(report.notes),
        Heading("Provenance"),
        *_provenance(report),
        Code(changed_settings(report.config), "toml"),
        settings_details(settings),
    ]
    return page(dive_document(report, opening, drawn, behind))


def changed_settings(config: Mapping[str, Any]) -> str:
    """Write the settings that are not the defaults, a line each."""
    usual = dict(flattened(msgspec.to_builtins(Config())))
    lines = [f"{key} = {json.dumps(value)}" for key, value in flattened(config) if usual.get(key, ...) != value]
    return "\n".join(["# what differs from the defaults", *lines] if lines else ["# the defaults"])


def heading(report: Report) -> str:
    """State in one line what was replayed, and what has become of each believed improvement."""
    return "; ".join([_replayed(report), *(f"{name}: {_in_short(found)}" for name, found in report.filters.items())])


def _replayed(report: Report) -> str:
    candidates = f"{', '.join(report.filters)} against " if report.filters else ""
    return f"{report.log.name}: {candidates}{report.baseline} over {report.log.duration_s:.1f} s"


def _in_short(candidate: Candidate) -> str:
    """State the judgement, and of what is believed whether it is borne out."""
    word = candidate.improvement.upper() if candidate.improvement in _LOUD else candidate.improvement
    if candidate.improvement == Judgement.NOT_JUDGED:
        return word
    belief = f", {candidate.belief}" if candidate.belief != Belief.UNDECIDED else ""
    return f"{word}; {percent(candidate.mean_improvement_pct)} believed{belief}"


def closing_lines(report: Report) -> tuple[str, ...]:
    """State for each candidate what its mean improvement is, and whose opinion that is."""
    trust = "reference error and consistency" if has_reference(report) else "coasting and consistency"
    return tuple(
        f"{name}: mean improvement over nine states {percent(means.mean_improvement_pct)} (believed by the filter's "
        f"own covariance; see {trust}), "
        f"mean convergence {percent(means.mean_convergence_improvement_pct)} sooner "
        f"({percent(means.mean_convergence_unchanged_pct)} without any change; by the nearest approach "
        f"{percent(means.mean_nearest_approach_improvement_pct)})"
        for name, means in report.filters.items()
        if means.improvement != Judgement.NOT_JUDGED
    )


def _provenance(report: Report) -> Iterator[Part]:
    yield Facts(
        {
            "log": report.log.name,
            "SHA-256 of the log": report.log.sha256 or "none",
            "span on the log's clock": f"{report.log.start_ns} to {report.log.end_ns} ns",
            "tool": f"{report.tool.name} {report.tool.version}",
            "with": ", ".join(f"{name} {version}" for name, version in report.versions.items()),
        }
    )
    yield DisplayTable(
        "Channels of the log",
        ("topic", "type", "encoding", "role", "messages"),
        "llllr",
        tuple(
            (channel.topic, channel.type_name, channel.encoding, channel.role or "not used", str(channel.messages))
            for channel in report.log.channels
        ),
    )


def _figure(title: str, caption: str, content: str) -> Html:
    return Html(f"<figure><figcaption><strong>{title}</strong><span>{caption}</span></figcaption>{content}</figure>")


def _bars(report: Report) -> Iterator[str]:
    """Draw what each candidate believes to have gained beside what was measured, where both are known."""
    gains = {name: list(_gains(report, name)) for name in report.filters}
    known = {name: found for name, found in gains.items() if found}
    if known:
        # Beside several candidates there is room for the mean, and for one of the states that have a measured error.
        most = _MOST_GAINS if len(known) > 1 else None
        rows = "".join(
            f'<tr><th scope="rowgroup" colspan="4"><b>{escape(visible(name))}</b></th></tr>'
            + "".join(_gain_row(*gain) for gain in found[:most])
            for name, found in known.items()
        )
        yield (
            '<section><h3>smaller errors, <b>believed</b> (blue) and <b>measured</b></h3><table class="bars"><thead>'
            '<tr><th>quantity</th><th class="r">believed</th><th class="r">measured</th><th class="axis">'
            "<span>&minus;100&nbsp;%</span><span>0</span><span>100&nbsp;%</span></th></tr></thead>"
            f"<tbody>{rows}</tbody></table></section>"
        )


def _gains(report: Report, name: str) -> Iterator[tuple[str, float | None, float | None]]:
    """Yield label, believed and measured improvement in percent, of what has both: the mean beside the first piece."""
    measured, believed_pct = _measured_pct(report, name), report.filters[name].mean_improvement_pct
    for quantity, measured_pct in list(measured.items())[:1] if believed_pct is not None else ():
        yield f"mean / {label(quantity)}", believed_pct, measured_pct
    for row in report.tables.improvement:
        quantity = _MEASURED_BY.get(row.state, "")
        if row.filter == name and quantity in measured:
            axis = label(row.state).partition(", ")[2]
            yield quantity if quantity == "heading" else f"{quantity}, {axis}", row.improvement_pct, measured[quantity]


def _measured_pct(report: Report, name: str) -> dict[str, float]:
    """Return how much smaller errors and drifts were, by quantity of the evidence; nothing where nothing is judged."""
    if report.filters[name].improvement == Judgement.NOT_JUDGED:
        return {}
    return {
        row.quantity: 100.0 * (1.0 - row.ratio)
        for row in report.tables.evidence
        if row.filter == name and row.evidence in ("accuracy", "coasting") and row.ratio is not None
    }


def _gain_row(label: str, believed_pct: float | None, measured_pct: float | None) -> str:
    bars = _bar("believed", believed_pct, 1) + _bar("measured", measured_pct, 9)
    return (
        f'<tr><th scope="row">{escape(label)}</th><td class="r">{percent(believed_pct)}</td>'
        f'<td class="r">{percent(measured_pct)}</td><td class="axis"><svg viewBox="-100 0 200 16" '
        f'preserveAspectRatio="none"><path class="zero" d="M0 0V16"/>{bars}</svg></td></tr>'
    )


def _bar(style: str, value_pct: float | None, top: int) -> str:
    if value_pct is None:
        return ""
    end = max(-_FULL_PCT, min(_FULL_PCT, value_pct))
    return f'<rect class="{style}" x="{min(0.0, end):.1f}" y="{top}" width="{abs(end):.1f}" height="6"/>'
