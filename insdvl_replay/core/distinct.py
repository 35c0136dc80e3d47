"""Which of several results are of dives of their own: copies count once, and parts of one recording are told.

Dives are the same if their logs are, or if the IMU's readings are equal where their times overlap, whatever the logs
are called and however they are encoded. Times of a copy may be later by a constant, as in another time zone.
"""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, Protocol, TypeVar

from insdvl_replay.core.dive_record import ImuFingerprint
from insdvl_replay.core.errors import Note, listed
from insdvl_replay.core.notes import note

LEAST_EQUAL: Final = 0.5  # share of the samples of a time that both have; rounding changes a few
LEAST_MOVED: Final = 3  # different readings at one distance in time; two may be equal by chance
CONTINUED_S: Final = 60.0  # between the end of one file and the beginning of the next


class LoggedDive(Protocol):
    """What a result tells of its log."""

    @property
    def name(self) -> str:
        """Name of the dive."""

    @property
    def sha256(self) -> str:
        """Digest of the log; empty if it was no file."""


class DiveReport(Protocol):
    """A result of this or another version."""

    @property
    def log(self) -> LoggedDive:
        """The log that was replayed."""

    @property
    def imu_fingerprint(self) -> ImuFingerprint | None:
        """Digests of its IMU; None in early results."""

    @property
    def vehicle(self) -> str:
        """Which vehicle made it; empty if nobody said."""


AnyReport = TypeVar("AnyReport", bound=DiveReport)


def distinct_dives(reports: Sequence[AnyReport]) -> tuple[list[AnyReport], list[Note]]:
    """Return a report for each dive, in their order, and notes of what is the same dive or the next part of one.

    Of several reports of a dive the one with the longest log is kept, of equal ones the first.
    """
    first_of = list(range(len(reports)))  # the first known report of the same dive, by report
    seen: dict[object, list[int]] = {}  # reports by what two of one dive have in common
    for number, report in enumerate(reports):
        keys = _keys(report)
        alike: set[int] = set()  # by what they have in common
        for key in keys:
            alike.update(seen.get(key, ()))
        same = {first_of[other] for other in alike if is_same_dive(report, reports[other])}
        first = min(same, default=number)
        if same:
            first_of = [first if known in same or known == number else known for known in first_of]
        for key in keys:
            seen.setdefault(key, []).append(number)
    kept: list[AnyReport] = []
    notes: list[Note] = []
    groups: dict[int, list[AnyReport]] = {}
    for first, report in zip(first_of, reports, strict=True):
        groups.setdefault(first, []).append(report)
    for group in groups.values():
        longest = max(group, key=_length_ns)
        kept.append(longest)
        if len(group) > 1:
            notes.append(_same_note(group, longest))
    return kept, [*notes, *_continued_notes(kept)]


def _keys(report: DiveReport) -> set[object]:
    """Return digests, of which two reports of one dive have at least one in common."""
    found = report.imu_fingerprint
    keys = set[object]()
    if report.log.sha256:
        keys.add(report.log.sha256)
    if found is not None:
        keys.update(zip(found.at_s, found.digests, strict=True))
        keys.update(_readings_met_once(found))
    return keys


def is_same_dive(one: DiveReport, other: DiveReport) -> bool:
    """Return whether two results are of the same log, or of IMUs with equal readings at equal or moved times."""
    if one.log.sha256 and one.log.sha256 == other.log.sha256:
        return True
    ours = one.imu_fingerprint
    theirs = other.imu_fingerprint
    if ours is None or theirs is None:
        return False
    both, equal = _compared(ours, theirs)
    if both > 0 and equal >= LEAST_EQUAL * both:
        return True
    return _is_moved_copy(ours, theirs)


def _compared(ours: ImuFingerprint, theirs: ImuFingerprint, moved_s: int = 0) -> tuple[int, int]:
    """Count the times that both have, and those with equal readings; their times are later by ``moved_s``."""
    known = dict(zip(ours.at_s, ours.digests, strict=True))
    both = 0
    equal = 0
    for at_s, digest in zip(theirs.at_s, theirs.digests, strict=True):
        if at_s - moved_s in known:
            both += 1
            equal += known[at_s - moved_s] == digest
    return both, equal


def _is_moved_copy(ours: ImuFingerprint, theirs: ImuFingerprint) -> bool:
    """Return whether most readings of the shorter one are in the other, all at one distance in time.

    The distances are those between times of fingerprints, whole tens of seconds, as of two time zones.
    """
    ours_at = _readings_met_once(ours)
    theirs_at = _readings_met_once(theirs)
    common = ours_at.keys() & theirs_at.keys()
    distances = Counter(theirs_at[digest] - ours_at[digest] for digest in common)
    if not distances:
        return False
    moved_s, count = distances.most_common(1)[0]
    both, equal = _compared(ours, theirs, moved_s)
    shorter = min(len(ours.at_s), len(theirs.at_s))
    return count >= LEAST_MOVED and equal >= LEAST_EQUAL * both and both >= LEAST_EQUAL * shorter


def _readings_met_once(fingerprint: ImuFingerprint) -> dict[str, int]:
    """Return the time of each reading that comes once; at rest, a coarse IMU repeats others."""
    times = Counter(fingerprint.digests)
    samples = zip(fingerprint.at_s, fingerprint.digests, strict=True)
    return {digest: at_s for at_s, digest in samples if times[digest] == 1}


def _length_ns(report: DiveReport) -> int:
    found = report.imu_fingerprint
    if found is None:
        return 0
    return found.last_ns - found.first_ns


def _same_note(group: Sequence[DiveReport], kept: DiveReport) -> Note:
    others = [report.log.name for report in group if report is not kept]
    code = "dives_same"
    if len(others) == 1:
        code = "dives_same one"
    return note(
        code,
        len(others),
        others=listed(others),
        kept=kept.log.name,
    )


def _continued_notes(reports: Sequence[DiveReport]) -> list[Note]:
    """Note dives that begin where another one of the same vehicle ends, or a little before.

    Those that begin earlier have times in common, at which their readings tell whether they are the same.
    """
    ends: dict[str, list[tuple[ImuFingerprint, str]]] = {}
    for report in reports:
        if report.imu_fingerprint is not None:
            ends.setdefault(report.vehicle, []).append((report.imu_fingerprint, report.log.name))
    notes = []
    for parts in ends.values():
        ordered = sorted(parts, key=lambda part: part[0].first_ns)
        for (before, ended), (after, begun) in pairwise(ordered):
            pause_s = (after.first_ns - before.last_ns) * 1e-9
            is_compared = bool(set(before.at_s) & set(after.at_s))
            if pause_s <= CONTINUED_S and not is_compared:
                when = "after" if pause_s >= 0.0 else "before"
                notes.append(
                    note(
                        "dives_continue",
                        begun=begun,
                        pause_s=abs(pause_s),
                        when=when,
                        ended=ended,
                    )
                )
    return notes
