"""The details of the public benchmark: each cell with its evidence, command and digest, its checks, and the dives."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from benchmark_cells import WORDS, Cell, common_reason
from benchmark_dives import data_set_of, name_of
from benchmark_page import candidates_of, result_of, with_evidence, word_of
from written import markdown_table

from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import label
from insdvl_replay.core.tables import PooledRow, share_text
from insdvl_replay.core.words import ReasonCode, Role
from insdvl_replay.evaluation.sentences import interval_text, ratio_text, why_undecided

EVIDENCE: Final = ("evidence", "role", "ratio", "interval", "dives", "acts", "at most")
# The rows that are listed, and what they may do.
ROLES: Final = {
    Role.PRIMARY: "decides",
    Role.SECONDARY: "can warn",
    Role.VETO: "can warn",
    Role.SETTLING: "second answer",
}
TOO_FEW: Final = (ReasonCode.ONE_DIVE, ReasonCode.FEW_DIVES)


def details(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Write each data set with its cells, those without evidence in short."""
    shown = with_evidence(sets)
    parts = []
    for name, cells in sets.items():
        parts.append(f"## {name}")
        if name in shown:
            for cell in candidates_of(cells):
                parts += cell_details(cell)
        else:
            parts += _without_evidence(candidates_of(cells))
    return "\n\n".join(parts)


def cell_details(cell: Cell) -> Iterator[str]:
    """Yield heading, word, evidence and command of a cell; nothing of a filter that cannot run there."""
    if not cell.reports:
        return
    yield f"### {cell.data_set} {cell.candidate}"
    yield f"{_word_with_reason(cell)}. Digest of logs and settings: `{cell.digest}`"
    if cell.answer is not None and cell.rows:
        rows = [_evidence(row) for row in cell.answer.known if row.role in ROLES]
        yield markdown_table(EVIDENCE, rows)
    yield f"```console\n$ {cell.command}\n```"


def _evidence(row: PooledRow) -> tuple[str, ...]:
    return (
        label(row.quantity),
        ROLES[Role(row.role)],
        ratio_text(row.ratio),
        interval_text(row),
        str(row.dives),
        share_text(row.acts),
        share_text(row.acts_most),
    )


def _word_with_reason(cell: Cell) -> str:
    """Say the word of a cell, and on how many dives it is not evaluated and why."""
    said = [word_of(cell) or "no evidence"]
    if cell.answer is not None:
        why = why_undecided(cell.answer)
        if why and cell.decisive is not None:
            said.append(why)
    dives = counted(len(cell.reports) + len(cell.errors), "dive")
    for why, names in cell.reasons.items():
        said.append(f"not evaluated on {len(names)} of {dives} ({', '.join(names)}): {why}")
    return "; ".join(said)


def _without_evidence(cells: Sequence[Cell]) -> Iterator[str]:
    """Yield why a data set has no evidence, and a command that shows it."""
    yield f"No evidence: {common_reason(cells)}."
    yield f"```console\n$ {cells[0].command}\n```"


# --- The checks of the benchmark itself.


def checks(sets: Mapping[str, Sequence[Cell]]) -> str:
    """Say how the planted candidates came out on the data sets with evidence."""
    header = ("candidate", "what it is", "must be", "data set", "is", "as it must")
    rows = []
    for name in with_evidence(sets):
        for cell in sets[name]:
            if cell.is_planted:
                rows.append(_check(cell))
    return markdown_table(header, rows)


def _check(cell: Cell) -> tuple[str, ...]:
    wanted = WORDS["planted"][cell.candidate]
    outcome = "-"
    if cell.answer is not None and cell.answer.undecided not in TOO_FEW:
        outcome = "yes" if re.fullmatch(wanted, str(cell.answer.verdict)) else "no"
    return (
        f"`{cell.candidate}`",
        WORDS["planted_filters"][cell.candidate],
        wanted.removesuffix(".*"),
        cell.data_set,
        result_of(cell),
        outcome,
    )


# --- The dives.


def dives_table(dives: Sequence[Mapping[str, Any]]) -> str:
    """List the dives, with links to their logs or tables."""
    rows = []
    for dive in dives:
        rows.append(
            (data_set_of(dive), name_of(dive), _links(dive), dive["licence"], dive["faults"])
        )
    return markdown_table(("data set", "dive", "log", "licence", "known faults"), rows)


def _links(dive: Mapping[str, Any]) -> str:
    if "url" in dive:
        return f"[log]({dive['url']})"
    files = dive.get("files", ())
    if not files:
        return "no link"
    return ", ".join(f"[{file['name'].partition('.')[0]}]({file['url']})" for file in files)
