"""Compare trajectories of several dives with those of a reference: the verdict of NEW against OLD."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, cast

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace as changed

from insdvl_replay.checks.fingerprint import imu_fingerprint
from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.dive_record import ImuFingerprint
from insdvl_replay.core.errors import (
    ConfigError,
    LogError,
    Note,
    counted,
    listed,
    require_known,
)
from insdvl_replay.core.notes import note
from insdvl_replay.core.quantities import (
    ACCURACY,
    STRETCHES,
    TRACK,
    TRACK_STRETCHES,
    WITHOUT_VERDICT,
    label,
)
from insdvl_replay.core.runtime import track_progress
from insdvl_replay.core.tables import CredibilityRow, EvidenceRow, Number, finite
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.evaluation import answers
from insdvl_replay.evaluation.answers import (
    BAD,
    NOISY,
    CandidateAnswer,
    CandidateOnDive,
    answer_over_dives,
    answers_together,
)
from insdvl_replay.evaluation.interval import LEVEL, RunSpread, run_spread
from insdvl_replay.evaluation.pose_errors import (
    MAX_DIFF_S,
    PARTS,
    Delta,
    Poses,
    absolute_errors,
    associated,
    pairs_of_poses,
    relative_errors,
    statistics,
)
from insdvl_replay.evaluation.sentences import headline
from insdvl_replay.evaluation.track_alignment import Align, NoAlignmentError, aligned
from insdvl_replay.logs.trajectory import AXES, Axes
from insdvl_replay.trajectories.dive_evidence import (
    DiveEvidence,
    Pairing,
    dive_evidence,
    share_covered,
)
from insdvl_replay.trajectories.files import (
    DiveFiles,
    RunFile,
    Side,
    find_side,
    match_sides,
    parse_given,
)
from insdvl_replay.trajectories.tracks import (
    Placed,
    Remark,
    Track,
    as_readings,
    at_times,
    common_times,
    frame_remarks,
    in_frame_of,
    lacking,
    read_tracks,
    require_other_than_truth,
)

WELL_COVERED: Final = 0.9
_MOST_LOG: Final = 50.0  # of a factor that is written
ONE_FRAME: Final = Delta(1.0, "f")
# What may be named to decide.
DECIDERS: Final = (
    *TRACK,
    *TRACK_STRETCHES,
    *(name for name in ACCURACY if name not in STRETCHES),
)


class TrajectoryErrorRow(Struct, frozen=True):
    """One pose error of a run against the reference, as evo gives it."""

    log: Annotated[str, Meta(description="dive")]
    filter: str
    run: Annotated[str, Meta(description="folder of repeated runs; empty for a single run")]
    quantity: Annotated[
        str,
        Meta(description="ape or rpe, with translation, rotation (Frobenius norm), angle or full"),
    ]
    unit: str
    delta: Annotated[str, Meta(description="length of relative errors: 1 f, or metres")]
    pairs: Annotated[str, Meta(description="of relative errors: consecutive or all")]
    poses: Annotated[int, Meta(description="poses or pairs that were compared")]
    rmse: Number
    mean: Number
    median: Number
    std: Number
    min: Number
    max: Number
    sse: Number


class TrajectoryDive(Struct, frozen=True):
    """A dive and a filter on it."""

    log: str
    filter: str
    reference: Annotated[str, Meta(description="file")]
    old: Annotated[tuple[str, ...], Meta(description="files of the repeated runs of OLD")]
    new: Annotated[tuple[str, ...], Meta(description="files of the repeated runs of NEW")]
    times: Annotated[int, Meta(description="times at which both are compared")]
    ratio: Annotated[Number, Meta(description="of the quantity that decides, NEW over OLD")]
    reason: Annotated[str, Meta(description="why the dive says nothing; empty if it does")] = ""


class TrajectoryAnswer(answers.Answer, frozen=True, kw_only=True):
    """The verdict on NEW against OLD over all dives."""

    verdict_always: Annotated[
        Verdict, Meta(description="by intervals that may be looked at after every dive")
    ]
    sentence: str
    run_factor: Annotated[
        Number,
        Meta(
            description="95 % of the ratios of single runs are within this factor, in the quantity that decides, and "
            "no interval is narrower; null without repeated runs"
        ),
    ] = None

    @property
    def is_harm(self) -> bool:
        """Whether it fails `--fail-on worse`."""
        return self.verdict in BAD


class TrajectoryComparison(Struct, frozen=True):
    """Trajectories of OLD and of NEW, compared with those of the reference."""

    old: str
    new: tuple[str, ...]
    reference: str
    align: Annotated[str, Meta(description="none, yaw, se3 or sim3")]
    baseline: Annotated[str, Meta(description="name of OLD in the tables")]
    answers: tuple[TrajectoryAnswer, ...]
    dives: tuple[TrajectoryDive, ...]
    evidence: tuple[EvidenceRow, ...]
    trajectory_errors: tuple[TrajectoryErrorRow, ...]
    credibility: tuple[CredibilityRow, ...]
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class Options:
    """How trajectories are compared."""

    align: Align = Align.NONE
    axes: Axes | None = None  # of OLD and NEW; None: those of their format
    reference_axes: Axes | None = None
    primary: str = ""  # quantity that decides; empty: by what the dives contain
    max_diff_s: float = MAX_DIFF_S  # of the stamps of poses, for pose errors
    deltas: Sequence[Delta] = (ONE_FRAME,)
    all_pairs: bool = False
    dives: Sequence[str] = ()  # only these


def options_of(
    *,
    align: str | None = None,
    axes: str | None = None,
    reference_axes: str | None = None,
    primary: str | None = None,
    max_diff_s: float | None = None,
    rpe: Sequence[str] = (),
    all_pairs: bool = False,
    dives: Sequence[str] = (),
) -> Options:
    """Return options as they are given in words; what is left out has its usual value.

    A ConfigError for a word or a length that is not known.
    """
    usual = Options()
    require_known("align", align or usual.align, list(Align))
    for name in (axes, reference_axes):
        require_known("axes", name or "enu_flu", AXES)
    if primary:
        require_known("quantity", primary, DECIDERS, most=len(DECIDERS))
    if max_diff_s is None:
        max_diff_s = usual.max_diff_s
    if not 0.0 <= max_diff_s < math.inf:
        raise ConfigError(f"max_diff {max_diff_s:g}: is no time in seconds", "such as 0.01")
    return Options(
        align=Align(align or usual.align),
        axes=cast(Axes | None, axes),
        reference_axes=cast(Axes | None, reference_axes),
        primary=primary or usual.primary,
        max_diff_s=max_diff_s,
        deltas=[parse_delta(text) for text in rpe] or usual.deltas,
        all_pairs=all_pairs,
        dives=dives,
    )


def parse_delta(text: str) -> Delta:
    """Read the length of relative errors, such as ``1f`` or ``100m``."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+) ?(f|m)", text.strip())
    if match is None or not 0.0 < float(match[1]) < math.inf:
        hint = "poses or metres, such as --rpe 1f or --rpe 100m"
        raise ConfigError(f"--rpe {text}: is no length", hint)
    size = float(match[1])
    if match[2] == "f" and not size.is_integer():
        raise ConfigError(f"--rpe {text}: is no whole number of poses", "such as --rpe 1f")
    return Delta(size, match[2])


# --- Dives as others know them.


class _Log(Struct, frozen=True):
    name: str
    sha256: str = ""


class _DiveRecord(Struct, frozen=True):
    """A dive by which copies are known."""

    log: _Log
    imu_fingerprint: ImuFingerprint | None
    vehicle: str = ""


@dataclass
class _Found:
    """What was found of one dive."""

    files: DiveFiles
    record: _DiveRecord
    truth_digests: tuple[str, ...]
    evidence: dict[str, DiveEvidence] = field(default_factory=dict)  # by candidate
    times: dict[str, int] = field(default_factory=dict)
    pose_errors: list[TrajectoryErrorRow] = field(default_factory=list)
    notes: list[tuple[str, Note]] = field(default_factory=list)  # of readers, by filter
    remarks: list[tuple[str, Remark]] = field(default_factory=list)  # by filter


def compare_trajectories(
    old: str, new: Sequence[str], reference: str, options: Options = Options()
) -> TrajectoryComparison:
    """Compare trajectories, each side a folder with a file for each run, or one file.

    Raises
    ------
    ConfigError
        A side has no trajectory, no dive has files on all sides, or a quantity or dive is not known.
    LogError
        No dive can be compared; the reason is that of the first one.
    """
    sides, notes = _sides(old, new, reference)
    before, *candidates, truth = sides
    dives, more = match_sides(before, candidates, truth)
    notes += more
    found, same = _distinct(_all_found(_chosen(dives, options.dives), before.name, options, notes))
    notes += _notes_of_files(found)
    names = [side.name for side in candidates]
    compared = _answers(found, before.name, names, options)
    notes += [*same, *_same_truth_notes(found)]
    result = TrajectoryComparison(
        old=before.given.text,
        new=tuple(side.given.text for side in candidates),
        reference=truth.given.text,
        align=options.align,
        baseline=before.name,
        answers=tuple(compared),
        dives=tuple(_dive_rows(found, compared)),
        evidence=tuple(_all_rows(found, "rows")),
        trajectory_errors=tuple(row for each in found for row in each.pose_errors),
        credibility=tuple(_all_rows(found, "credibility")),
        notes=tuple(notes),
    )
    # What is not finite is missing, as in JSON.
    return msgspec.json.decode(msgspec.json.encode(result), type=TrajectoryComparison)


def _chosen(dives: Sequence[DiveFiles], names: Sequence[str]) -> list[DiveFiles]:
    """Return the dives with some names, or all; a ConfigError for a name that no dive has."""
    for name in names:
        require_known("dive", name, [dive.name for dive in dives])
    return [dive for dive in dives if not names or dive.name in names]


def _all_found(
    dives: Sequence[DiveFiles], baseline: str, options: Options, notes: list[Note]
) -> list[_Found]:
    """Compare dive by dive; those that cannot be compared are noted, if there are others."""
    found = list[_Found]()
    errors = list[LogError]()
    for dive in track_progress("dive", dives):
        try:
            found.append(_found_of(dive, baseline, options))
        except LogError as error:
            errors.append(error)
            notes.append(note("trajectory_failed", dive=dive.name, why=error.message))
    if not found:
        raise errors[0]
    return found


def _distinct(found: Sequence[_Found]) -> tuple[list[_Found], list[Note]]:
    """Count copies of a dive once."""
    kept, notes = distinct_dives([each.record for each in found])
    numbers = {id(record) for record in kept}
    return [each for each in found if id(each.record) in numbers], notes


def _sides(old: str, new: Sequence[str], reference: str) -> tuple[list[Side], list[Note]]:
    """Find OLD, all NEW and the reference, each with a name of its own."""
    given = [parse_given(text) for text in (old, *new, reference)]
    texts = [each.text for each in given]
    for number, text in enumerate(texts):
        if text in texts[:number] and (number == len(texts) - 1 or number > 1):
            raise ConfigError(f"{text}: is named twice", "name another side")
    sides = list[Side]()
    notes = list[Note]()
    names = _names(given[:-1])
    for name, each in zip((*names, "reference"), given, strict=True):
        side, more = find_side(name, each)
        sides.append(side)
        notes += more
    return sides, notes


def _names(given: Sequence[Any]) -> list[str]:
    """Name each filter after its folder or file, and as much above it, and its topic, as tells them apart."""
    paths = [each.path.absolute() for each in given]
    for length in range(1, max(len(path.parts) for path in paths)):
        names = ["_".join((*path.parts[-length:-1], path.stem)) for path in paths]
        if len(set(names)) == len(names):
            return names
    names = list[str]()
    for path, each in zip(paths, given, strict=True):
        name = each.topic.strip("/").replace("/", "_") or path.stem
        if name in names:
            name = f"{name}_{len(names) + 1}"
        names.append(name)
    return names


# --- One dive.


def _found_of(dive: DiveFiles, baseline: str, options: Options) -> _Found:
    """Read and compare all runs of one dive."""
    files = [dive.truth, *dive.old]
    for runs in dive.new.values():
        files += runs
    axes = [options.reference_axes, *[options.axes] * (len(files) - 1)]
    truth, *tracks = read_tracks(files, axes)
    by_file = dict(zip(files[1:], tracks, strict=True))
    for track in tracks:
        require_other_than_truth(truth, track)
    old = [by_file[file] for file in dive.old]
    common_ns = common_times(truth, tracks[:1])
    span = (int(common_ns[0]), int(common_ns[-1]))
    # Simulated dives may share a reference, but no two have the same estimate.
    record = _DiveRecord(_Log(dive.name), imu_fingerprint(as_readings(tracks[0], *span)))
    of_truth = imu_fingerprint(as_readings(truth, *span))
    found = _Found(dive, record, of_truth.digests)
    found.notes += [("reference", each) for each in truth.notes]
    for name, runs in dive.new.items():
        new = [by_file[file] for file in runs]
        pairing, remarks = _pairing(dive.name, (baseline, name), truth, (old, new), options)
        found.remarks += remarks
        evidence = dive_evidence(pairing)
        found.evidence[name] = evidence
        found.remarks += [(name, each) for each in _noise_remarks(evidence)]
        found.times[name] = len(pairing.time_ns)
    by_filter: dict[str, Sequence[RunFile]] = {baseline: dive.old, **dive.new}
    for name, of_filter in by_filter.items():
        for file in of_filter:
            track = by_file[file]
            rows = _pose_errors(dive.name, name, file, truth, track, options)
            found.pose_errors += rows
            found.notes += [(name, each) for each in track.notes]
            found.remarks += [(name, each) for each in _run_remarks(truth, track, rows)]
    return found


def _pairing(
    log: str,
    names: tuple[str, str],
    truth: Track,
    sides: tuple[Sequence[Track], Sequence[Track]],
    options: Options,
) -> tuple[Pairing, list[tuple[str, Remark]]]:
    """Bring the runs of two filters to common times and into the frame of the reference."""
    old, new = sides
    time_ns = common_times(truth, [*old, *new])
    reference = at_times(truth, time_ns)
    remarks = list[tuple[str, Remark]]()
    placed = list[list[Placed]]()
    for name, side in zip(names, sides, strict=True):
        runs = list[Placed]()
        for track in side:
            run = in_frame_of(reference, at_times(track, time_ns), options.align, options.axes)
            remarks += [(name, each) for each in frame_remarks(reference, run, options.align)]
            runs.append(run)
        placed.append(runs)
    for name, side, others in ((names[0], old, new), (names[1], new, old)):
        missing = lacking(side[0], others[0])
        if missing:
            remarks.append((name, Remark("trajectory_lacks", " and ".join(missing))))
    return Pairing(log, names, time_ns, reference, placed[0], placed[1]), remarks


def _noise_remarks(evidence: DiveEvidence) -> Iterable[Remark]:
    """Yield that most of the position error is noise of the reference."""
    for row in evidence.rows:
        if row.quantity == "position" and finite(row.reference_noise) > NOISY:
            yield Remark("trajectory_noise", f"{evidence.noise.position_m:.3g} m")


def _run_remarks(truth: Track, run: Track, rows: Sequence[TrajectoryErrorRow]) -> Iterable[Remark]:
    """Yield what is odd about a run: that it covers too little, or has no pose near one of the reference."""
    share = share_covered(run, int(truth.known_ns[0]), int(truth.known_ns[-1]))
    if share < WELL_COVERED:
        yield Remark("trajectory_coverage", f"{100.0 * share:.0f} %")
    if run.has_position and not rows:
        yield Remark("trajectory_stamps")


def _pose_errors(
    log: str,
    name: str,
    file: RunFile,
    truth: Track,
    run: Track,
    options: Options,
) -> list[TrajectoryErrorRow]:
    """Return the absolute and relative pose errors of a run; none where no stamps agree."""
    reference, estimate = associated(truth.poses(), run.poses(), options.max_diff_s)
    if not len(estimate.time_ns):
        return []
    try:
        transform = aligned(estimate.position_m, reference.position_m, options.align)
    except NoAlignmentError:
        return []
    moved = transform.moved(estimate.position_m)
    estimate = Poses(estimate.time_ns, moved, transform.mat @ estimate.mat)
    rows = list[TrajectoryErrorRow]()

    def add(kind: str, errors: dict[str, Any], delta: str, pairs: str) -> None:
        for part, values in errors.items():
            found = statistics(values)._asdict()
            row = TrajectoryErrorRow(
                log=log,
                filter=name,
                run=file.repeat,
                quantity=f"{kind}_{part}",
                unit=PARTS[part],
                delta=delta,
                pairs=pairs,
                **found,
            )
            rows.append(row)

    add("ape", absolute_errors(reference, estimate), "", "")
    for delta in options.deltas:
        pairs = pairs_of_poses(estimate, delta, all_pairs=options.all_pairs)
        which = "all" if options.all_pairs else "consecutive"
        add("rpe", relative_errors(reference, estimate, pairs), delta.text, which)
    return rows


# --- All dives.


def _answers(
    found: Sequence[_Found], baseline: str, names: Sequence[str], options: Options
) -> list[TrajectoryAnswer]:
    """Answer for each candidate; several share the error rate of one."""

    def answer_at(name: str, level: float) -> CandidateAnswer:
        return _answer(found, baseline, name, level, options)

    together = answers_together(names, answer_at)
    return [_with_sentence(answer, _spreads(found, name)) for name, answer in together.items()]


def _answer(
    found: Sequence[_Found], baseline: str, name: str, level: float, options: Options
) -> CandidateAnswer:
    dives = list[CandidateOnDive]()
    for each in found:
        if name not in each.evidence:
            continue
        evidence = each.evidence[name]
        rows = evidence.rows
        if options.primary:
            rows = [_named_primary(row, options.primary) for row in rows]
        dive = CandidateOnDive(
            log=each.files.name,
            baseline=baseline,
            vehicle="",
            verdict=Verdict.NOT_EVALUATED if evidence.reason else Verdict.UNDECIDED,
            reason=evidence.reason,
            predicted_pct=None,
            rows=rows,
        )
        dives.append(dive)
    spreads = _spreads(found, name)
    answer = answer_over_dives(name, dives, primary=options.primary, level=level, spreads=spreads)
    if answer.verdict in WITHOUT_VERDICT or answer.decisive is not None:
        return answer
    return changed(answer, reason=_lacking(found, name, options.primary))


def _named_primary(row: EvidenceRow, primary: str) -> EvidenceRow:
    if row.quantity == primary:
        return changed(row, role=Role.PRIMARY)
    return row


def _lacking(found: Sequence[_Found], name: str, primary: str) -> str:
    """Say what the dives lack for a verdict."""
    if primary:
        return f"no {label(primary)} on any dive"
    evidence = [each.evidence[name] for each in found if name in each.evidence]
    if any(each.rows for each in evidence):
        return "no common position; name what decides with --primary heading"
    return "no error is common to both"


def _spreads(found: Sequence[_Found], name: str) -> dict[str, RunSpread]:
    """Return how far repeated runs differ, by quantity."""
    evidence = [each.evidence[name] for each in found if name in each.evidence]
    quantities = dict[str, None]()
    for each in evidence:
        quantities.update(dict.fromkeys((*each.old_logs, *each.new_logs)))
    spreads: dict[str, RunSpread] = {}
    for quantity in quantities:
        old = [each.old_logs.get(quantity, ()) for each in evidence]
        new = [each.new_logs.get(quantity, ()) for each in evidence]
        spreads[quantity] = run_spread(old, new)
    if "position" in spreads:
        for quantity in TRACK:
            spreads.setdefault(quantity, spreads["position"])
    return spreads


def _with_sentence(answer: CandidateAnswer, spreads: Mapping[str, RunSpread]) -> TrajectoryAnswer:
    spread = spreads.get(answer.primary)
    factor = None
    if spread is not None:
        factor = math.exp(min(spread.half_width(LEVEL), _MOST_LOG))
    return TrajectoryAnswer(
        filter=answer.filter,
        baseline=answer.baseline,
        verdict=answer.verdict,
        verdict_always=answer.verdict_always,
        dives=answer.dives,
        evaluated=answer.evaluated,
        rows=answer.rows,
        primary=answer.primary,
        settling=answer.settling,
        undecided=answer.undecided,
        reason=answer.reason,
        sentence=f"{answer.filter} against {answer.baseline}: {headline(answer)}.",
        run_factor=factor,
    )


def _same_truth_notes(found: Sequence[_Found]) -> Iterable[Note]:
    """Note dives that have the same reference, but other estimates."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for each in found:
        groups.setdefault(each.truth_digests, []).append(each.files.name)
    for digests, names in groups.items():
        if digests and len(names) > 1:
            yield note("trajectory_same_truth", len(names), names=listed(names))


def _all_rows(found: Iterable[_Found], name: str) -> Iterable[Any]:
    """Yield the rows of a table of all dives; those of the baseline once."""
    seen = set[tuple[str, str, str]]()
    for each in found:
        for evidence in each.evidence.values():
            for row in getattr(evidence, name):
                key = (row.log, row.filter, row.quantity)
                if key not in seen:
                    seen.add(key)
                    yield row


def _dive_rows(
    found: Sequence[_Found], compared: Sequence[TrajectoryAnswer]
) -> Iterable[TrajectoryDive]:
    """Yield each dive and filter, with its ratio in the quantity that decides."""
    for answer in compared:
        for each in found:
            if answer.filter not in each.evidence:
                continue
            evidence = each.evidence[answer.filter]
            ratio = math.nan
            for row in evidence.rows:
                if row.quantity == answer.primary:
                    ratio = finite(row.ratio)
            yield TrajectoryDive(
                log=each.files.name,
                filter=answer.filter,
                reference=str(each.files.truth.path),
                old=tuple(str(file.path) for file in each.files.old),
                new=tuple(str(file.path) for file in each.files.new[answer.filter]),
                times=each.times[answer.filter],
                ratio=ratio,
                reason=evidence.reason,
            )


def _notes_of_files(found: Sequence[_Found]) -> Iterable[Note]:
    """Yield the notes of readers, and those on runs, one for all dives of a filter."""
    of_readers: dict[tuple[str, str], list[tuple[str, Note]]] = {}
    of_runs: dict[tuple[str, str], dict[str, str]] = {}
    for each in found:
        log = each.files.name
        for name, said in each.notes:
            of_readers.setdefault((name, said.code), []).append((log, said))
        for name, remark in each.remarks:
            text = f"{log} ({remark.value})" if remark.value else log
            of_runs.setdefault((name, remark.code), {})[text] = log
    for (name, _), notes in of_readers.items():
        log, first = notes[0]
        place = f"{name}, {log}"
        if len(notes) > 1:
            place += f" and {counted(len(notes) - 1, 'other file')}"
        yield first.about(place)
    for (name, code), texts in of_runs.items():
        yield note(code, len(texts), name=name, dives=listed(texts))


def find_violation(comparison: TrajectoryComparison, limit: str | None) -> str | None:
    """Return the sentences of what fails `--fail-on worse` or `--fail-on undecided`; None if nothing does."""
    if limit is None:
        return None
    found = list[str]()
    for answer in comparison.answers:
        is_open = answer.verdict in (Verdict.UNDECIDED, *WITHOUT_VERDICT)
        if answer.is_harm or (limit == "undecided" and is_open):
            found.append(answer.sentence)
    return " ".join(found) or None
