"""Which of several results are of dives of their own: copies count once, and parts of one recording are told.

So are vehicles that are probably mistyped, since each would count as one more vehicle.

Dives are the same if their logs are, or if the IMU's readings are equal where their times overlap, whatever the logs
are called and however they are encoded. Times of a copy may be later by any constant: no two dives have the same noise.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Final, Protocol, TypeVar

from insdvl_replay.core.dive_record import ImuFingerprint
from insdvl_replay.core.errors import Note, listed
from insdvl_replay.core.notes import note

LEAST_EQUAL: Final = 0.5  # share of the samples of a time that both have; rounding changes a few
LEAST_MOVED: Final = 4  # different readings at one distance in time; a few may be equal by chance
SAME_DISTANCE_MS: Final = 100  # by which stamps of a copy scatter, as those by arrival do
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
        sure = _sure_keys(report)
        marks = _marks(report)
        alike = _having(sure, seen, at_least=1) | _having(marks, seen, at_least=LEAST_MOVED)
        same = {first_of[other] for other in alike if is_same_dive(report, reports[other])}
        first = min(same, default=number)
        if same:
            first_of = [first if known in same or known == number else known for known in first_of]
        for key in sure | marks:
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
    return kept, [*notes, *_continued_notes(kept), *_mistyped_vehicles(kept)]


def _having(
    keys: Iterable[object], seen: Mapping[object, Sequence[int]], at_least: int
) -> set[int]:
    """Return the reports that have at least so many of some keys."""
    counts = Counter[int]()
    for key in keys:
        counts.update(seen.get(key, ()))
    return {number for number, count in counts.items() if count >= at_least}


def _sure_keys(report: DiveReport) -> set[object]:
    """Return digests, of which two reports of one dive with the same times have at least one in common."""
    found = report.imu_fingerprint
    keys = set[object]()
    if report.log.sha256:
        keys.add(report.log.sha256)
    if found is not None:
        keys.update(zip(found.at_s, found.digests, strict=True))
    return keys


def _marks(report: DiveReport) -> set[object]:
    """Return the marks of a report, of which two of one dive have several in common."""
    if report.imu_fingerprint is None:
        return set()
    return set(report.imu_fingerprint.marks)


def is_same_dive(one: DiveReport, other: DiveReport) -> bool:
    """Return whether two results are of the same log, or of IMUs with equal readings at equal or moved times."""
    if one.log.sha256 and one.log.sha256 == other.log.sha256:
        return True
    ours = one.imu_fingerprint
    theirs = other.imu_fingerprint
    if ours is None or theirs is None:
        return False
    both, equal = _at_equal_times(ours, theirs)
    if both > 0 and equal >= LEAST_EQUAL * both:
        return True
    return _is_moved_copy(ours, theirs)


def _at_equal_times(ours: ImuFingerprint, theirs: ImuFingerprint) -> tuple[int, int]:
    """Count the times that both have, and those with equal readings."""
    known = dict(zip(ours.at_s, ours.digests, strict=True))
    both = 0
    equal = 0
    for at_s, digest in zip(theirs.at_s, theirs.digests, strict=True):
        if at_s in known:
            both += 1
            equal += known[at_s] == digest
    return both, equal


def _is_moved_copy(ours: ImuFingerprint, theirs: ImuFingerprint) -> bool:
    """Return whether most marks of the shorter one are in the other, all at one distance in time."""
    ours_ms = dict(zip(ours.marks, ours.marked_ms, strict=True))
    theirs_ms = dict(zip(theirs.marks, theirs.marked_ms, strict=True))
    common = ours_ms.keys() & theirs_ms.keys()
    distances_ms = sorted(theirs_ms[mark] - ours_ms[mark] for mark in common)
    equal = _most_at_one_distance(distances_ms)
    one_in = max(ours.one_in, theirs.one_in)
    fewest = min(_marks_of_one_in(one_in, ours), _marks_of_one_in(one_in, theirs))
    return equal >= LEAST_MOVED and equal >= LEAST_EQUAL * fewest


def _most_at_one_distance(distances_ms: Sequence[int]) -> int:
    """Return how many of sorted distances are nearly equal, at most."""
    most = 0
    first = 0
    for last, distance_ms in enumerate(distances_ms):
        while distance_ms - distances_ms[first] > SAME_DISTANCE_MS:
            first += 1
        most = max(most, last - first + 1)
    return most


def _marks_of_one_in(one_in: int, fingerprint: ImuFingerprint) -> float:
    """Return how many marks there would be of one in so many samples."""
    return len(fingerprint.marks) * fingerprint.one_in / one_in


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


def _mistyped_vehicles(reports: Sequence[DiveReport]) -> list[Note]:
    """Note vehicles of one dive whose name differs by one letter from that of a vehicle with several dives."""
    dives = Counter(report.vehicle for report in reports if report.vehicle)
    notes = []
    for report in reports:
        if dives[report.vehicle] != 1:
            continue
        for other, count in dives.items():
            if count > 1 and _differ_by_one_letter(report.vehicle, other):
                found = note(
                    "vehicle_mistyped", name=report.log.name, vehicle=report.vehicle, other=other
                )
                notes.append(found)
                break
    return notes


def _differ_by_one_letter(one: str, other: str) -> bool:
    """Return whether a letter of one name is another, missing or added, or only capitals differ; digits are numbers."""
    ours = one.casefold()
    theirs = other.casefold()
    if ours == theirs:
        return one != other
    begin = _letters_in_common(ours, theirs)
    end = _letters_in_common(ours[begin:][::-1], theirs[begin:][::-1])
    left = ours[begin : len(ours) - end]
    right = theirs[begin : len(theirs) - end]
    return max(len(left), len(right)) == 1 and not (left + right).isdigit()


def _letters_in_common(one: str, other: str) -> int:
    """Return with how many equal letters two texts begin."""
    count = 0
    for ours, theirs in zip(one, other, strict=False):
        if ours != theirs:
            break
        count += 1
    return count
