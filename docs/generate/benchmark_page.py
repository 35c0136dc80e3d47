"""The page of the public benchmark: one matrix of filters and data sets, and what is said about it."""

import math
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from benchmark_cells import WITH_ASSAY, WORDS, Cell, common_reason
from written import PROJECT, markdown_table

from insdvl_replay.core.errors import counted, listed
from insdvl_replay.core.quantities import label
from insdvl_replay.core.tables import PooledRow, finite, share_text
from insdvl_replay.core.words import ReasonCode, Role
from insdvl_replay.evaluation.interval import BAND
from insdvl_replay.evaluation.sentences import interval_text, plan_line, ratio_text
from insdvl_replay.show import answers

DETAILS: Final = "benchmark_details.md"
# The interval of a cell: characters to each side of the one in the middle, which is the band of equal results.
SIDE: Final = 7
STEP: Final = 2.0 * math.log(BAND)  # of the logarithm of the ratio, from one character to the next
RAISED: Final = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
FALSE_SHARE: Final = 0.05  # of wrong words on equal filters, at most: docs/verdict.md
FEWEST_VEHICLES: Final = 3  # that are pooled
ONE_DIVE: Final = "one dive"
# What decides the numbers of the page.
SOURCES: Final = ("insdvl_replay", "benchmarks/public", "examples/candidates", "docs/generate")


@dataclass
class Footnotes:
    """Reasons that are written once, and the marks of cells that have them."""

    marks: dict[str, str] = field(default_factory=dict)

    def mark(self, reasons: Iterable[str]) -> str:
        """Return the marks of some reasons."""
        found = []
        for why in reasons:
            number = str(len(self.marks) + 1)
            found.append(self.marks.setdefault(why, number.translate(RAISED)))
        return " ".join(found)

    @property
    def lines(self) -> list[str]:
        """The footnotes."""
        return [f"{mark} {why}." for why, mark in self.marks.items()]


def by_data_set(cells: Iterable[Cell]) -> dict[str, list[Cell]]:
    """Return the cells of each data set, in the order of words.toml; planted ones come last."""
    order = [*WORDS["filters"], *WORDS["planted"]]
    found: dict[str, list[Cell]] = {}
    for cell in cells:
        found.setdefault(cell.data_set, []).append(cell)
    for of_set in found.values():
        of_set.sort(key=lambda cell: (_place_in(order, cell.candidate), cell.candidate))
    return found


def _place_in(order: Sequence[str], name: str) -> int:
    """Return the place of a filter; those that nobody has described come before the planted ones."""
    if name in order:
        return order.index(name)
    return len(WORDS["filters"])


def candidates_of(cells: Iterable[Cell]) -> list[Cell]:
    """Leave out what is planted."""
    return [cell for cell in cells if not cell.is_planted]


def with_evidence(sets: Mapping[str, Sequence[Cell]]) -> dict[str, list[Cell]]:
    """Return the data sets on which at least one candidate has evidence, with their candidates."""
    found = {}
    for name, cells in sets.items():
        candidates = candidates_of(cells)
        if any(cell.has_evidence for cell in candidates):
            found[name] = candidates
    return found


# --- The matrix.


def matrix(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Write the matrix, its footnotes, and a line for each data set without evidence."""
    shown = with_evidence(sets)
    footnotes = Footnotes()
    header = ["filter"]
    filters: dict[str, None] = {}
    for name, cells in shown.items():
        header.append(_head(name, cells))
        filters.update(dict.fromkeys(cell.candidate for cell in cells))
    rows = []
    for candidate in filters:
        row = [f"`{candidate}`"]
        for cells in shown.values():
            row.append(_text_of(candidate, cells, footnotes))
        rows.append(row)
    parts = [markdown_table(header, rows)]
    parts += footnotes.lines
    empty = [name for name in sets if name not in shown]
    lines = [_line_without_evidence(name, sets[name]) for name in empty]
    if lines:
        parts.append("Without evidence:\n\n" + "\n".join(lines))
    parts.append(pooled_line(shown))
    parts.append(false_words_line(shown))
    return "\n\n".join(parts)


def _head(name: str, cells: Sequence[Cell]) -> str:
    """Name a data set, its dives, and the quantity that decides."""
    dives = max(len(cell.reports) for cell in cells)
    quantity = label(usual_quantity(cells))
    return f"[{name}]({DETAILS}#{name})<br>{counted(dives, 'dive')}, {quantity}"


def usual_quantity(cells: Sequence[Cell]) -> str:
    """Return the quantity that decides in most cells."""
    counts = Counter(cell.decisive.quantity for cell in cells if cell.decisive is not None)
    return counts.most_common(1)[0][0]


def _text_of(candidate: str, cells: Sequence[Cell], footnotes: Footnotes) -> str:
    """Write a cell: ratio, interval, word and how far the filter acts; empty but for a footnote if there is none."""
    for cell in cells:
        if cell.candidate == candidate:
            return cell_text(cell, usual_quantity(cells), footnotes)
    return ""


def cell_text(cell: Cell, usual: str, footnotes: Footnotes) -> str:
    """Write a cell of the matrix."""
    mark = footnotes.mark(cell.reasons)
    row = cell.decisive
    if row is None:
        return mark
    words = [word_of(cell)]
    if row.quantity != usual:
        words.append(label(row.quantity))
    if row.dives != len(cell.reports) or cell.errors:
        words.append(counted(row.dives, "dive"))
    words.append(f"acts {share_text(row.acts)}")
    ratio = f"[{ratio_text(row.ratio)}]({DETAILS}#{anchor(cell)})"
    return f"{ratio} `{interval_bar(row)}`<br>{', '.join(words)} {mark}".rstrip()


def word_of(cell: Cell) -> str:
    """Return the word of a cell; one dive has none."""
    if cell.answer is None:
        return ""
    if cell.answer.undecided == ReasonCode.ONE_DIVE:
        return ONE_DIVE
    return str(cell.answer.verdict)


def anchor(cell: Cell) -> str:
    """Return the heading of a cell's details, as links have it."""
    return f"{cell.data_set}-{cell.candidate}"


def interval_bar(row: PooledRow) -> str:
    """Draw an interval in characters, each a factor of 1.10; the one in the middle is the band of equal results."""
    marks = ["·"] * (2 * SIDE + 1)
    marks[SIDE] = "│"
    low = finite(row.low)
    high = finite(row.high)
    if low > 0.0 and high > 0.0:
        for place in range(_character(low), _character(high) + 1):
            marks[place] = "━"
    marks[_character(finite(row.ratio))] = "●"
    return "".join(marks)


def _character(ratio: float) -> int:
    """Return the character of a ratio; of one beyond the ends, the last."""
    place = round(math.log(ratio) / STEP)
    return SIDE + max(-SIDE, min(SIDE, place))


def _line_without_evidence(name: str, cells: Sequence[Cell]) -> str:
    """Say why a data set has no evidence."""
    candidates = candidates_of(cells)
    dives = set[str]()
    for cell in candidates:
        dives |= {*cell.reports, *cell.errors}
    why = common_reason(candidates)
    return f"- [{name}]({DETAILS}#{name}), {counted(len(dives), 'dive')}: {why}"


def pooled_line(shown: Mapping[str, Sequence[Cell]]) -> str:
    """Say why data sets are not pooled."""
    counts = Counter(label(usual_quantity(cells)) for cells in shown.values())
    having = [f"{quantity} decides on {number}" for quantity, number in counts.items()]
    return (
        f"Data sets are not pooled. That takes {FEWEST_VEHICLES} vehicles or more with the same "
        f"deciding quantity; here {listed(having) or 'nothing decides'}."
    )


def false_words_line(shown: Mapping[str, Sequence[Cell]]) -> str:
    """Say how many wrong words the matrix is expected to have at most."""
    judged = 0
    for cells in shown.values():
        for cell in cells:
            if cell.decisive is not None and math.isfinite(finite(cell.decisive.low)):
                judged += word_of(cell) != ONE_DIVE
    most = FALSE_SHARE * judged
    return (
        f"An interval gives the word of {counted(judged, 'cell')}. If no filter differed from its baseline, at most "
        f"{100.0 * FALSE_SHARE:.0f} % of them would be called better or worse "
        f"([measured](verdict.md#how-often-the-rule-is-right)). So at most {most:.1f} wrong words are expected here."
    )


# --- What the dives can show.


def assay(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Write which planted faults of the baseline the dives of each data set show."""
    shown = [name for name, cells in sets.items() if _assay_rows(cells)]
    faults: dict[str, None] = {}
    texts: dict[tuple[str, str], str] = {}
    for name in shown:
        for row in _assay_rows(sets[name]):
            faults[row.filter] = None
            text = f"{ratio_text(row.ratio)} {answers.verdict_in_table(row)}"
            texts[name, row.filter] = text.rstrip()
    rows = []
    for fault in faults:
        rows.append([f"`{fault}`", *(texts.get((name, fault), "") for name in shown)])
    return markdown_table(["planted fault", *shown], rows)


def _assay_rows(cells: Sequence[Cell]) -> list[PooledRow]:
    """Return the planted faults of a data set, in the quantity that decides there."""
    candidates = [cell for cell in candidates_of(cells) if cell.has_evidence]
    if not candidates:
        return []
    primary = usual_quantity(candidates)
    for cell in cells:
        if cell.candidate == WITH_ASSAY:
            rows = answers.assay_of([*cell.reports.values()], primary)
            return [row for row in rows if row.role == Role.PRIMARY]
    return []


def plans(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Say what change the dives of each data set find, by the scatter of the paper's method."""
    lines = []
    for name, cells in with_evidence(sets).items():
        first = next(iter(cells))
        if first.answer is not None:
            lines.append(f"- {name}, `{first.candidate}`: {plan_line(first.answer)}")
    return "\n".join(line for line in lines if not line.endswith(": "))


def filters_table() -> str:
    """List the filters, and what they are."""
    rows = [(f"`{name}`", text) for name, text in WORDS["filters"].items()]
    return markdown_table(("filter", "what it is"), rows)


# --- What changed, and when it was made.


def changes(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Say what was changed after a first table, and where it said something else."""
    lines = []
    for change in WORDS["changed"]:
        said = [change["said"]] if "said" in change else []
        for name, before in change.get("before", {}).items():
            said += _said_before(before, sets.get(name, ()))
        lines.append(f"- {change['what']}. The first table: {'; '.join(said)}.")
    return "\n".join(lines)


def _said_before(before: Mapping[str, str], cells: Sequence[Cell]) -> list[str]:
    """Return what a table said before of the cells that say something else now."""
    same = []
    other = []
    for cell in cells:
        if cell.candidate not in before:
            continue
        if before[cell.candidate] == result_of(cell):
            same.append(f"`{cell.candidate}`")
        else:
            other.append(f"`{cell.candidate}` {before[cell.candidate]}")
    said = [*other]
    if same:
        said.append(f"the same for {listed(same)}")
    return said


def result_of(cell: Cell) -> str:
    """Write ratio, interval and word of a cell."""
    if cell.decisive is None:
        return word_of(cell)
    row = cell.decisive
    if math.isnan(finite(row.low)):
        return f"{ratio_text(row.ratio)} {word_of(cell)}"
    return f"{ratio_text(row.ratio)} ({interval_text(row)}) {word_of(cell)}"


def stamp() -> str:
    """Return date and commit of the last change of what decides the numbers; empty without git."""
    made = _git("log", "-1", "--format=%cs, %h", "--abbrev=8", "--", *SOURCES)
    if made and _git("status", "--porcelain", "--", *SOURCES):
        return f"{made}, changed since"
    return made


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(PROJECT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
