"""A recorder whose clock was set during a recording: which part of the log has one clock, and is used.

After a step of more than a day, the log times alone tell the parts. A step back of less than a day leads into times
that the log has already, so that the order of the messages in the file tells the sides. Messages that were only written
late, or files that were joined, are no sides: only a clock that was set gives the same times twice in every channel.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Mask, TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.units import TIME_UNITS_NS

Span = tuple[int, int]

# No recorder waits for longer in the middle of a dive: after a larger step its clock was set.
CLOCK_SET_NS: Final = TIME_UNITS_NS["d"]
# Messages are not under way for longer, and recorders write them within this time.
SET_BACK_NS: Final = NS_PER_S
# Messages of a log with more steps back are not in the order of recording.
_MOST_STEPS: Final = 4
# Where times go by twice, messages of both sides alternate. A single late one, or a batch, does not.
_LEAST_CHANGES: Final = 10
_LEAST_SHARE: Final = 0.1  # of the messages at these times
# Parts of a dive that were joined in another order follow one another sooner than this.
_JOINED_NS: Final = 60 * NS_PER_S
# A channel that goes on without a longer pause, in usual steps, shows that its clock was not set.
_PAUSE_STEPS: Final = 5


@dataclass(frozen=True)
class OneClock:
    """The longest part of a recording whose clock was set."""

    first_ns: int  # log times of this part
    last_ns: int
    set_s: float  # after the first message, when the clock was set for the first time
    from_ns: int  # the last time before it, and the first one behind it
    to_ns: int
    unused: int  # messages of other parts

    def holds(self, log_time_ns: TimeNs) -> Mask:
        """Return which messages are of this part."""
        return np.asarray((log_time_ns >= self.first_ns) & (log_time_ns <= self.last_ns))

    @property
    def note(self) -> Note:
        """Report that the clock was set, and what is used."""
        before = np.datetime64(self.from_ns, "ns").astype("M8[s]")
        after = np.datetime64(self.to_ns, "ns").astype("M8[s]")
        length_s = (self.last_ns - self.first_ns) / NS_PER_S
        return note(
            "clock_set",
            self.unused,
            set_s=self.set_s,
            before=before,
            after=after,
            length_s=length_s,
        )


@dataclass(frozen=True)
class OneSide(OneClock):
    """The longest side of a recording whose clock was set back by less than a day."""

    rows: Mapping[
        int, Span
    ]  # by channel that shows the step, its first row of this side and the end
    others: tuple[Span, ...]  # first and last log time of the other sides

    @property
    def back_ns(self) -> int:
        """By how much the clock was set back for the first time."""
        return self.from_ns - self.to_ns

    def holds_rows(
        self,
        channel_id: int,
        first: int,
        log_time_ns: TimeNs,
    ) -> Mask:
        """Return which messages of a channel, from a row on, are of this side.

        Of a channel that is too slow to show the step, these are the messages at times that no other side has.
        """
        if channel_id in self.rows:
            begin, end = self.rows[channel_id]
            row = np.arange(first, first + log_time_ns.size)
            return np.asarray((row >= begin) & (row < end))
        held = self.holds(log_time_ns)
        for first_ns, last_ns in self.others:
            held &= (log_time_ns < first_ns) | (log_time_ns > last_ns)
        return held

    @property
    def note(self) -> Note:
        """Report by how much the clock was set back, and what is used."""
        return note(
            "clock_set back",
            self.unused,
            back_s=self.back_ns / NS_PER_S,
            set_s=self.set_s,
            before=np.datetime64(self.from_ns, "ns").astype("M8[s]"),
            length_s=(self.last_ns - self.first_ns) / NS_PER_S,
        )


def spans_a_step(first_ns: int, last_ns: int) -> bool:
    """Return whether log times span so much that the clock may have been set."""
    return last_ns - first_ns > CLOCK_SET_NS


def one_clock(log_times: Sequence[TimeNs]) -> OneClock | None:
    """Find the longest part with one clock; None where it was not set. Times are in the order of the file, by channel.

    A clock is set by more than a day, forward or back.
    """
    known = [times for times in log_times if times.size]
    if not known:
        return None
    ordered = np.sort(np.concatenate(known))
    steps = np.flatnonzero(_between_ns(ordered[:-1], ordered[1:]) > CLOCK_SET_NS)
    if not steps.size:
        return None
    firsts = ordered[np.append(0, steps + 1)]
    lasts = ordered[np.append(steps, ordered.size - 1)]
    lengths_ns = _between_ns(firsts, lasts)
    longest = int(np.argmax(lengths_ns))
    # Of the channel with the most messages, the part of its first message was recorded first.
    often = max(known, key=len)
    part_of = np.searchsorted(firsts, often, "right") - 1
    begun = int(part_of[0])
    next_part = (begun + 1) % len(firsts)
    others = np.flatnonzero(part_of != begun)
    if others.size:
        next_part = int(part_of[others[0]])
    first_ns = int(firsts[longest])
    last_ns = int(lasts[longest])
    used = int(np.searchsorted(ordered, last_ns, "right") - np.searchsorted(ordered, first_ns))
    return OneClock(
        first_ns=first_ns,
        last_ns=last_ns,
        set_s=float(lengths_ns[begun]) / NS_PER_S,
        from_ns=int(lasts[begun]),
        to_ns=int(firsts[next_part]),
        unused=ordered.size - used,
    )


def _between_ns(earlier_ns: TimeNs, later_ns: TimeNs) -> NDArray[np.uint64]:
    """Return what lies between times. Damaged ones may be 600 years apart, which a signed number does not hold."""
    return np.asarray(later_ns.astype(np.uint64) - earlier_ns.astype(np.uint64))


# --- A clock that is set back by less than a day.


class _Step(NamedTuple):
    """A step back of a channel."""

    row: int  # of the first message behind it
    before_ns: int  # log times of the messages around it
    after_ns: int
    is_apart: bool  # whether no times are gone through twice


def may_be_set_back(log_times: Mapping[int, TimeNs]) -> bool:
    """Return whether the channel with the most messages steps back a few times, each channel in the file's order."""
    often = max(log_times.values(), key=len, default=np.empty(0, np.int64))
    return 0 < _drops(often, SET_BACK_NS).size <= _MOST_STEPS


def one_side(log_times: Mapping[int, TimeNs]) -> OneSide | None:
    """Find the longest side of a clock that was set back; None where it was not. Channels are in the file's order."""
    if not may_be_set_back(log_times):
        return None
    often_id = max(log_times, key=lambda channel_id: len(log_times[channel_id]))
    often = log_times[often_id]
    steps = []
    for step in _steps_of(often):
        if not any(_goes_on(times, step) for times in log_times.values()):
            steps.append(step)
    if not steps:
        return None
    bounds = {often_id: [0, *[step.row for step in steps], often.size]}
    for channel_id in log_times.keys() - {often_id}:
        times = log_times[channel_id]
        cuts = _cuts(times, steps)
        if len(cuts) == len(steps):
            bounds[channel_id] = [0, *cuts, times.size]
    return _longest_side(log_times, bounds, steps[0])


def _drops(times: TimeNs, least_ns: int) -> NDArray[np.int64]:
    """Return the rows whose time is before that of the row before, by more than so much and less than a day."""
    steps_ns = np.diff(times)
    return 1 + np.flatnonzero((steps_ns < -least_ns) & (steps_ns > -CLOCK_SET_NS))


def _steps_of(often: TimeNs) -> Iterator[_Step]:
    """Give the steps back of a channel around which there are two sides, and not one recording in another order."""
    bounds = [0, *_drops(often, SET_BACK_NS).tolist(), often.size]
    for begin, row, end in zip(bounds, bounds[1:], bounds[2:], strict=False):
        before = often[begin:row]
        after = often[row:end]
        ahead_ns = int(before.min()) - int(after.max())
        is_apart = ahead_ns > 0
        are_sides = _alternate(before, after)
        if is_apart:
            are_sides = ahead_ns > _JOINED_NS and min(before.size, after.size) >= _LEAST_CHANGES
        if are_sides:
            yield _Step(row, int(often[row - 1]), int(often[row]), is_apart)


def _alternate(before: TimeNs, after: TimeNs) -> bool:
    """Return whether messages before and behind a step alternate at the times that both have."""
    first_ns = max(int(before.min()), int(after.min()))
    last_ns = min(int(before.max()), int(after.max()))
    times = np.concatenate([before, after])
    is_after = np.arange(times.size) >= before.size
    twice = (times >= first_ns) & (times <= last_ns)
    order = np.argsort(times[twice], kind="stable")
    changes = np.count_nonzero(np.diff(is_after[twice][order]))
    return bool(changes >= max(_LEAST_CHANGES, _LEAST_SHARE * order.size))


def _goes_on(times: TimeNs, step: _Step) -> bool:
    """Return whether a channel has no step back where another has, although it goes through all times there."""
    if _cuts(times, [step]):
        return False
    ordered = np.sort(times)
    begin = int(np.searchsorted(ordered, step.after_ns)) - 1
    end_ns = step.before_ns
    if step.is_apart:
        # Whoever goes on behind the last time before the step has the old clock.
        begin = max(begin, 0)
        end_ns += SET_BACK_NS
    end = int(np.searchsorted(ordered, end_ns, "right"))
    if begin < 0 or end >= ordered.size or end - begin < _LEAST_CHANGES:
        return False
    # The mean, because many messages may be recorded at once.
    steps_ns = np.diff(ordered)
    return bool(steps_ns[begin:end].max() <= _PAUSE_STEPS * steps_ns.mean())


def _cuts(times: TimeNs, steps: Sequence[_Step]) -> list[int]:
    """Return the rows of a channel that are the first ones behind steps back, of those that it shows."""
    cuts = [0]
    for step in steps:
        back_ns = step.before_ns - step.after_ns
        rows = _drops(times, back_ns // 2)
        before_ns = times[rows - 1]
        after_ns = times[rows]
        fits = (rows > cuts[-1]) & (before_ns - after_ns <= back_ns + 2 * SET_BACK_NS)
        fits &= before_ns <= step.before_ns + SET_BACK_NS
        fits &= after_ns >= step.after_ns - SET_BACK_NS
        if fits.any():
            largest = int(np.argmax((before_ns - after_ns)[fits]))
            cuts.append(int(rows[fits][largest]))
    return cuts[1:]


def _longest_side(
    log_times: Mapping[int, TimeNs],
    bounds: Mapping[int, Sequence[int]],
    first_step: _Step,
) -> OneSide:
    """Return the longest side; the bounds are the rows at which the sides of a channel begin, and its end."""
    spans: list[Span] = []
    for side in range(len(next(iter(bounds.values()))) - 1):
        parts = [log_times[id_][rows[side] : rows[side + 1]] for id_, rows in bounds.items()]
        spans.append(
            (
                min(int(part.min()) for part in parts),
                max(int(part.max()) for part in parts),
            )
        )
    lengths_ns = [last - first for first, last in spans]
    longest = int(np.argmax(lengths_ns))
    first_ns, last_ns = spans.pop(longest)
    found = OneSide(
        first_ns=first_ns,
        last_ns=last_ns,
        set_s=lengths_ns[0] / NS_PER_S,
        from_ns=first_step.before_ns,
        to_ns=first_step.after_ns,
        unused=0,
        rows={id_: (rows[longest], rows[longest + 1]) for id_, rows in bounds.items()},
        others=tuple(spans),
    )
    unused = 0
    for channel_id, times in log_times.items():
        unused += int(np.count_nonzero(~found.holds_rows(channel_id, 0, times)))
    return replace(found, unused=unused)
