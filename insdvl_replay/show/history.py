"""`history`: the ratio of each filter over the versions in a lake, and the steps where it changed."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

import numpy as np
from msgspec import Struct

from insdvl_replay.core.errors import ResultError, counted, require_known
from insdvl_replay.core.quantities import EVIDENCE_QUANTITIES, PRIMARIES, WITHOUT_VERDICT, label
from insdvl_replay.core.tables import Col, EvidenceRow, Number
from insdvl_replay.core.words import EvidenceVerdict, Role
from insdvl_replay.document.parts import (
    LIMIT,
    POINT,
    Block,
    Callout,
    Curve,
    Figure,
    Heading,
    Panel,
    Part,
    Result,
    Title,
    filter_style,
)
from insdvl_replay.document.tables import FORMS, shown
from insdvl_replay.evaluation.answers import CONTROL, primary_of
from insdvl_replay.evaluation.interval import BAND, level_of_candidates
from insdvl_replay.evaluation.sentences import ratio_text
from insdvl_replay.evaluation.steps import Change, History, Step, Version, history_of
from insdvl_replay.results.lake import read_lake
from insdvl_replay.show.plots.evidence import REACHED

if TYPE_CHECKING:
    import pandas as pd

_IDENTITY: Final = ("version", "settings_sha256", "code_sha256")
_COLUMNS: Final = (
    *("filter", "quantity", "ratio", "log_sha256", "vehicle", "filter_verdict"),
    *("revision", "started_at", *_IDENTITY),
)
_SEVERAL: Final = "several"
_DIGITS: Final = 8  # of a digest in the name of a version
# Columns that a narrow terminal leaves out, the values of both sides before their names.
_SPARE_OF_STEPS: Final = ((7, 8), (5, 6), 13)
_SPARE_OF_VERSIONS: Final = (2, 3)
_TONES: Final = {EvidenceVerdict.BETTER: "good", EvidenceVerdict.WORSE: "bad"}
_CAPTION: Final = (
    "Each point is the error of the candidate over that of the baseline, as a geometric "
    "mean over the dives of a "
    "version, so below 1 the candidate is better. Bars are 95 % intervals, which stay "
    "valid however often you look. "
    "A large point is a step. The table below says which version has which number."
)


class VersionRow(Struct, frozen=True):
    """One version of a filter: its ratio over the dives, and its change against an earlier version."""

    title: ClassVar = "Versions of {filter}"
    footnote: ClassVar = (
        "ratio: over all dives of the version, with a 95 % interval that stays valid "
        "however often you look. change: "
        "this ratio over that of the version under `against`, on the dives that both have; "
        "its interval allows for "
        "the number of versions. verdict: of the change, which is a step if it is better "
        "or worse by more than 5 %."
    )

    filter: Annotated[str, Col("Candidate, quantity, and the number of the version in time.")]
    quantity: str
    number: Annotated[int, Col(head="no.")]
    name: Annotated[
        str,
        Col(
            "As --revision named it; else the tool's version, and the beginnings of the digests of settings and code.",
            head="version",
        ),
    ]
    started_at: Annotated[
        str, Col("Start of its first replay (UTC, ISO 8601).", head="since", form="day")
    ]
    version: Annotated[
        str,
        Col("Version of the tool, digests of settings and code; several if its replays differ."),
    ]
    settings_sha256: str
    code_sha256: str
    dives: Annotated[int, Col("Dives with a ratio, and the ratio.", head="dives")]
    ratio: Annotated[Number, Col(head="ratio", form="ratio", primary=True, better="lower")]
    low: Annotated[Number, Col("The 95 % interval for every look.", head="low", form="ratio")]
    high: Annotated[Number, Col(head="high", form="ratio")]
    against: Annotated[
        str,
        Col(
            "The version that it is compared with; empty: none has three dives in common.",
            head="against",
        ),
    ]
    common: Annotated[int, Col("Dives of both.")]
    change: Annotated[
        Number,
        Col(
            "Its ratio over that of the other version, and the interval.",
            head="change",
            form="ratio",
        ),
    ]
    change_low: Annotated[Number, Col(head="low", form="ratio")]
    change_high: Annotated[Number, Col(head="high", form="ratio")]
    verdict: Annotated[
        str,
        Col("better, worse, equivalent or undecided; empty without comparison.", head="verdict"),
    ]


class StepRow(Struct, frozen=True):
    """A version at which the ratio of a filter changed."""

    title: ClassVar = "Steps"

    filter: Annotated[str, Col("Candidate and quantity.", head="filter")]
    quantity: Annotated[str, Col(head="quantity", form="label")]
    verdict: Annotated[str, Col("better or worse.", head="verdict")]
    name: Annotated[str, Col("The version from which on it is so, and its start.", head="step at")]
    started_at: Annotated[str, Col(head="since", form="day")]
    against: Annotated[
        str, Col("The version that it is compared with, and its start.", head="against")
    ]
    against_started_at: Annotated[str, Col(head="since", form="day")]
    ratio_from: Annotated[
        Number, Col("Ratios of both sides on their common dives.", head="from", form="ratio")
    ]
    ratio_to: Annotated[Number, Col(head="to", form="ratio")]
    change: Annotated[
        Number,
        Col(
            "The later ratio over the earlier one, with the interval for all versions together.",
            head="change",
            form="ratio",
        ),
    ]
    low: Annotated[Number, Col(head="low", form="ratio")]
    high: Annotated[Number, Col(head="high", form="ratio")]
    dives: Annotated[int, Col("Dives of both sides.", head="dives")]
    seen_at: Annotated[
        str, Col("The version that shows it, later than `name` where that alone could not tell.")
    ]
    changed: Annotated[
        str, Col("What differs from the version before: version, settings, code.", head="changed")
    ]


@dataclass(frozen=True)
class _Known:
    """What the lake says of a version beside its ratios."""

    number: int
    started_at: str
    identity: Mapping[str, str]  # version, settings, code

    def changed_since(self, earlier: "_Known") -> str:
        """Name what differs."""
        words = []
        for column, value in self.identity.items():
            if value != earlier.identity[column]:
                words.append(column.removesuffix("_sha256"))
        return ", ".join(words)


@dataclass(frozen=True)
class FilterHistory:
    """The versions of one filter."""

    filter: str
    quantity: str
    history: History
    known: Mapping[str, _Known]  # by the name of the version


# --- From the lake.


def read_histories(lake: Path, quantity: str = "") -> tuple[list[FilterHistory], str]:
    """Return the history of each filter in a lake, and a sentence on what is left out.

    Parameters
    ----------
    lake : Path
        The folder of the lake.
    quantity : str
        The quantity whose ratio it is; empty: the one that decides, for each filter.

    Raises
    ------
    ConfigError
        It is no lake.
    ResultError
        It has no ratio of the quantity.
    """
    wanted = [("quantity", "==", quantity)] if quantity else [("role", "==", Role.PRIMARY)]
    frame = read_lake(lake, _COLUMNS, wanted).to_pandas()
    frame = frame[~frame["filter_verdict"].isin(WITHOUT_VERDICT) & frame["ratio"].notna()]
    if not len(frame):
        raise _no_ratio(lake, quantity)
    text = {name: frame[name].astype(str) for name in frame.columns if name != "ratio"}
    frame = frame.assign(**text)
    frame, left_out = _of_revisions(frame)
    frame = frame.assign(name=_names(frame)).sort_values("started_at", kind="stable")
    names = [name for name in dict.fromkeys(frame["filter"]) if name != CONTROL]
    level = level_of_candidates(max(len(names), 1))
    histories = []
    for filter_ in sorted(dict.fromkeys(frame["filter"])):
        of_filter = frame[frame["filter"] == filter_]
        chosen = quantity or _primary(of_filter)
        rows = of_filter[of_filter["quantity"] == chosen]
        histories.append(_history(filter_, chosen, rows, level))
    return histories, left_out


def _no_ratio(lake: Path, quantity: str) -> ResultError:
    """Return the error of a lake without a ratio, with the number of replays whose filters have no verdict."""
    what = label(quantity) if quantity else "a quantity that decides"
    said = f"{lake}: has no ratio of {what}"
    frame = read_lake(lake, ("replay", "filter_verdict")).to_pandas()
    verdict = frame["filter_verdict"].astype(str)
    left_out = frame[verdict.isin(WITHOUT_VERDICT)]
    if not len(left_out):
        return ResultError(said, f"--quantity {PRIMARIES[0]}, or another name")
    words = " or ".join(sorted(verdict[left_out.index].unique()))
    replays = counted(left_out["replay"].nunique(), "replay")
    return ResultError(
        f"{said}; left out: {replays} with filters that are {words}",
        "the first line on each dive says why; settle this, then run the dives again with --lake",
    )


def _of_revisions(frame: "pd.DataFrame") -> "tuple[pd.DataFrame, str]":
    """Return the rows whose version has a name, where some have one, and say what that leaves out."""
    named = frame["revision"] != ""
    if not named.any() or named.all():
        return frame, ""
    count = len(frame.loc[~named, [*_IDENTITY, "log_sha256"]].drop_duplicates())
    replays = counted(count, "replay")
    return frame[named], f"left out, since other replays have a --revision: {replays} without"


def _names(frame: "pd.DataFrame") -> "pd.Series[str]":
    """Name the version of each row."""
    made = frame["version"] + " " + frame["settings_sha256"].str[:_DIGITS]
    made = (made + " " + frame["code_sha256"].str[:_DIGITS]).str.strip()
    return made.where(frame["revision"] == "", frame["revision"])


def _primary(rows: "pd.DataFrame") -> str:
    """Choose the quantity that decides, by all replays of a filter; where none decides for all, the most common one."""
    replays = []
    for _, of_replay in rows.groupby(["name", "log_sha256"], sort=False)["quantity"]:
        replays.append([_primary_row(quantity) for quantity in set(of_replay)])
    return primary_of(replays) or str(rows["quantity"].mode()[0])


def _primary_row(quantity: str) -> EvidenceRow:
    return EvidenceRow(
        log="",
        filter="",
        evidence="",
        quantity=quantity,
        unit="",
        baseline=None,
        value=None,
        ratio=None,
        role=Role.PRIMARY,
    )


def _history(filter_: str, quantity: str, rows: "pd.DataFrame", level: float) -> FilterHistory:
    versions = []
    known = {}
    for number, (name, of_version) in enumerate(rows.groupby("name", sort=False), 1):
        latest = of_version.drop_duplicates("log_sha256", keep="last")
        dives = latest["log_sha256"]
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(latest["ratio"].to_numpy(np.float64))
        ratios = dict(zip(dives, logs.tolist(), strict=True))
        vehicles = dict(zip(dives, latest["vehicle"], strict=True))
        started_at = dict(zip(dives, latest["started_at"], strict=True))
        versions.append(Version(str(name), ratios, vehicles, started_at))
        identity = {column: _one_of(latest[column]) for column in _IDENTITY}
        known[str(name)] = _Known(number, str(of_version["started_at"].iloc[0]), identity)
    return FilterHistory(filter_, quantity, history_of(versions, level), known)


def _one_of(values: "pd.Series[str]") -> str:
    """Return the value that all have."""
    found = set(values)
    if len(found) > 1:
        return _SEVERAL
    return found.pop()


# --- Rows.


def version_rows(found: FilterHistory) -> Iterator[VersionRow]:
    """Yield a row for each version."""
    history = found.history
    for version, change in zip(history.versions, history.changes, strict=True):
        known = found.known[version.name]
        interval = version.interval
        yield VersionRow(
            filter=found.filter,
            quantity=found.quantity,
            number=known.number,
            name=version.name,
            started_at=known.started_at,
            version=known.identity["version"],
            settings_sha256=known.identity["settings_sha256"],
            code_sha256=known.identity["code_sha256"],
            dives=interval.dives,
            ratio=_finite(interval.ratio),
            low=_finite(interval.low_always),
            high=_finite(interval.high_always),
            **_of_change(change),
        )


def _of_change(change: Change | None) -> dict[str, Any]:
    """Return the columns of a change."""
    if change is None:
        return {
            "against": "",
            "common": 0,
            "change": None,
            "change_low": None,
            "change_high": None,
            "verdict": "",
        }
    return {
        "against": change.before.name,
        "common": change.dives,
        "change": _finite(change.ratio),
        "change_low": _finite(change.low),
        "change_high": _finite(change.high),
        "verdict": change.word,
    }


def step_rows(found: FilterHistory) -> Iterator[StepRow]:
    """Yield a row for each step."""
    names = [version.name for version in found.history.versions]
    for step in found.history.steps:
        change = step.change
        at = found.known[step.version.name]
        before = found.known[change.before.name]
        previous = found.known[names[names.index(step.version.name) - 1]]
        yield StepRow(
            filter=found.filter,
            quantity=found.quantity,
            verdict=change.word,
            name=step.version.name,
            started_at=at.started_at,
            against=change.before.name,
            against_started_at=before.started_at,
            ratio_from=_finite(change.ratio_before),
            ratio_to=_finite(change.ratio_after),
            change=_finite(change.ratio),
            low=_finite(change.low),
            high=_finite(change.high),
            dives=change.dives,
            seen_at=step.seen_at.name,
            changed=at.changed_since(previous),
        )


def _finite(value: float) -> Number:
    if math.isfinite(value):
        return value
    return None


# --- Sentences.


def _sentences(found: FilterHistory) -> Iterator[Callout]:
    rows = list(step_rows(found))
    for step, row in zip(found.history.steps, rows, strict=True):
        yield Callout(_step_sentence(step, row), _TONES.get(step.change.word, ""))
    if not rows:
        yield Callout(_no_step(found))


def _step_sentence(step: Step, row: StepRow) -> str:
    text = (
        f"{row.filter}: {row.verdict} since {row.name} ({_day(row.started_at)}): {label(row.quantity)} ratio "
        f"{ratio_text(row.ratio_from)} -> {ratio_text(row.ratio_to)} on {counted(row.dives, 'dive')}, "
        f"change {_interval_text(step.change)} against {row.against} ({_day(row.against_started_at)})"
    )
    if row.seen_at != row.name:
        text = f"{text}; seen at {row.seen_at}"
    if row.changed:
        text = f"{text}; changed: {row.changed}"
    return text


def _no_step(found: FilterHistory) -> str:
    history = found.history
    head = f"{found.filter}: no step in {label(found.quantity)} over {counted(len(history.versions), 'version')}"
    changes = [change for change in history.changes if change is not None]
    if not changes:
        return f"{head}: none can be compared, which takes three dives that two versions have in common"
    last = changes[-1]
    if last.word == EvidenceVerdict.EQUIVALENT:
        return f"{head}: the last is equivalent to {last.before.name}"
    return (
        f"{head}: the last against {last.before.name} is undecided, change {_interval_text(last)}"
    )


def _interval_text(change: Change) -> str:
    ratio = ratio_text(change.ratio)
    if not math.isfinite(change.high):
        return f"{ratio} (no interval from {counted(change.dives, 'dive')})"
    return f"{ratio} ({ratio_text(change.low)} .. {ratio_text(change.high)})"


def _day(started_at: str) -> str:
    return str(FORMS["day"](started_at))


# --- The page.


def _panel(found: FilterHistory) -> Panel:
    """Draw the ratio over the versions, with bars, and steps as large points."""
    versions = found.history.versions
    numbers = np.arange(1.0, len(versions) + 1.0)
    intervals = [version.interval for version in versions]
    ratios = np.array([interval.ratio for interval in intervals])
    curves = []
    for number, interval in zip(numbers, intervals, strict=True):
        if math.isfinite(interval.high_always):
            ends = np.array([interval.low_always, interval.high_always])
            curves.append(Curve(np.array([number, number]), ends, filter_style(1), name=""))
    curves.append(Curve(numbers, ratios, f"{filter_style(1)} sigma", name="ratio"))
    curves.append(Curve(numbers, ratios, filter_style(1), points=True, name=""))
    at = [found.known[step.version.name].number for step in found.history.steps]
    if at:
        steps = np.array(at)
        curves.append(
            Curve(
                numbers[steps - 1],
                ratios[steps - 1],
                f"{filter_style(0)} {REACHED}",
                points=True,
                name="step",
            )
        )
    title = f"{found.filter}: {label(found.quantity)}, ratio to the baseline"
    return Panel(
        title,
        "number of the version",
        tuple(curves),
        levels=(1.0 / BAND, BAND),
        x_whole=True,
        x_limits=(0.5, len(versions) + 0.5),
    )


def history_result(lake: Path, quantity: str = "") -> Result:
    """Return the history of all filters in a lake."""
    if quantity:
        require_known("quantity", quantity, EVIDENCE_QUANTITIES)
    found, left_out = read_histories(lake, quantity)
    versions = list(chain.from_iterable(map(version_rows, found)))
    steps = list(chain.from_iterable(map(step_rows, found)))
    sentences = list(chain.from_iterable(map(_sentences, found)))
    panels = tuple(_panel(each) for each in found)
    legend = ((f"{filter_style(0)} {POINT} {REACHED}", "step"), (LIMIT, "band of 5 %"))
    figure = Figure("Ratio over versions", _CAPTION, panels, legend)
    title = f"History of {lake.name or lake}"
    parts: list[Part] = [Title(title), *sentences]
    if left_out:
        parts.append(left_out)
    parts += [Heading("Figures"), figure, Heading("Tables")]
    if steps:
        parts.append(replace(shown(StepRow, steps), spare=_SPARE_OF_STEPS))
    for each in found:
        table = shown(VersionRow, version_rows(each), filter=each.filter)
        parts.append(replace(table, spare=_SPARE_OF_VERSIONS))
    return Result(
        kind="history",
        title=title,
        sentences=[*sentences, *filter(None, [left_out])],
        tables={
            "step": Block.of(StepRow, steps),
            "version": Block.of(VersionRow, versions),
        },
        figures={"history": figure},
        document=parts,
    )


TABLES: Final[Mapping[str, type[Struct]]] = {"step": StepRow, "version": VersionRow}
"""The tables of `history`, by name."""
