"""Rows made clean: in the order of time, each time once, every number finite; and a note of every loss.

Samples that were never recorded show in the stamps of a regular sensor: pauses are then multiples of the usual step.
There is no such note where stamps jitter, come in bursts or have a changing rate, since pauses have any length then.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    Mask,
    Scalar,
    TimeNs,
    is_new,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.tables import (
    RECORDER_STAMPS,
    SAME_CLOCK_S,
    Rows,
    Table,
    find_order,
    repeated_rows,
)
from insdvl_replay.logs.formats.recorder_clock import CLOCK_SET_NS

_MARKS: Final = 2  # different numbers by which one instrument marks that it has no reading


def is_few(count: int, size: int) -> bool:
    """Return whether faults are single ones: one, or a small share of all, of which more are wrong in another way."""
    return count <= max(1.0, 0.05 * size)


def stand_for_none(impossible: Floats) -> bool:
    """Return whether readings that cannot be are a number, or two, by which an instrument marks that it has none."""
    return np.unique(np.abs(impossible)).size <= _MARKS


def shown(impossible: Floats) -> str:
    """Write readings that cannot be by their sizes, the smallest and the largest where they are many different ones."""
    sizes = np.unique(np.abs(impossible))
    if sizes.size <= _MARKS:
        return " and ".join(f"{size:g}" for size in sizes)
    return f"{sizes[0]:g} to {sizes[-1]:g}"


def same_rows(rows: Floats, others: Floats) -> Mask:
    """Find which rows are identical, where NaN is the same as NaN."""
    return np.asarray(((rows == others) | (np.isnan(rows) & np.isnan(others))).all(axis=1))


class Cleaner:
    """Chooses the rows of a topic that stay, and notes why the others went.

    Values and masks of good rows have one row for each of the k messages in the file. A `LogError` where the stamps
    contradict the recorder's clock in more than single messages, or two files hold different messages of the same time.
    """

    def __init__(self, table: Table) -> None:
        self.table = table
        self.role = table.source.role  # its code begins those of the notes
        self.notes: list[Note] = []
        self.time_ns = table.time_ns()  # (k,), times of validity in the order of the file
        log_time_ns = table.columns["log_time"][:, 0]
        raise_if_two_dives(table, self.time_ns)
        order = find_order(self.time_ns, log_time_ns)
        self.rows: Rows = order.rows  # that stay, in the order of time
        self._first_ns = int(self.time_ns[order.rows[0]])
        if order.wrong.size:
            first_s = float(seconds(log_time_ns[order.wrong], log_time_ns.min()).min())
            jumps = (
                f"{order.wrong.size} of {self.time_ns.size} messages have stamps '{table.source.stamp}' that jump "
                f"while the log time is steady; the first {first_s:.3f} s after the first message"
            )
            hint = f'{self.role}.stamp = "log_time"'
            if order.jump_s > SAME_CLOCK_S:
                text = f"{jumps}; their clock was set back by {order.jump_s:.3f} s"
                raise LogError(text, hint, *table.where)
            if not is_few(order.wrong.size, self.time_ns.size):
                raise LogError(jumps, hint, *table.where)
            self.note(
                "wrong_stamps",
                order.wrong.size,
                jumps=jumps,
            )
        if order.late.size:
            self.note(
                "out_of_order",
                order.late.size,
                order.late,
                late_s=order.late_s,
            )

    @property
    def times(self) -> TimeNs:
        """The times of the rows that stay."""
        return self.kept(self.time_ns)

    def kept(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return the rows of values that stay, in the order of time; the same array where all stay in place."""
        # No row is dropped or moved without a note.
        if self.notes:
            return values[self.rows]
        return values

    def keep(self, good: Mask, code: str, severity: Any = None, **fields: Any) -> None:
        """Drop the rows that are not good; the code, without the source, says what the dropped messages are like."""
        self._keep_rows(good[self.rows], code, severity, **fields)

    def keep_where(
        self,
        quantity: str,
        good: Callable[[Floats], Mask],
        code: str,
    ) -> None:
        """Drop the rows of which a number of a quantity is not good, if the topic holds it."""
        if quantity in self.table:
            self.keep(np.asarray(good(self.table.values(quantity)).all(axis=1)), code)

    def keep_finite(
        self,
        *values: Floats,
        code: str = "not_finite",
        is_expected: bool = False,
        **fields: Any,
    ) -> None:
        """Drop the rows in which a number is missing.

        Where all rows are expected to have it, it is a warning if rows next to each other lack it, or more than few.
        Else it is if most do.
        """
        # The extremes of a column of which a number is missing are missing.
        if all(np.isfinite([array.min(), array.max()]).all() for array in values if array.size):
            return
        finite = np.ones(self.time_ns.size, np.bool_)
        for array in values:
            for column in array.T:
                finite &= np.isfinite(column)
        lost = ~finite[self.rows]
        count = int(np.count_nonzero(lost))
        is_serious = 2 * count > lost.size
        if is_expected:
            is_serious = bool(np.any(lost[1:] & lost[:-1])) or not is_few(count, lost.size)
        severity = Severity.WARNING if is_serious else Severity.INFO
        self.keep(finite, code, severity, **fields)

    def keep_possible(
        self,
        possible: Mask,
        impossible: Floats,
        code: str,
    ) -> None:
        """Drop rows with impossible readings, shape (m,), unless these mean a wrong unit."""
        if not self._are_of_another_unit(~possible[self.rows], impossible):
            self.keep(possible, code, values=shown(impossible))

    def without_impossible(
        self, values: Floats, is_impossible: Mask, code: str, **fields: Any
    ) -> Floats:
        """Return values, (k, n), NaN where they cannot be, unless these mean a wrong unit."""
        impossible = values[is_impossible]
        rows: Mask = np.asarray(is_impossible.any(axis=1))
        has_any: Mask = np.asarray(~np.isnan(values).all(axis=1))
        if not impossible.size or self._are_of_another_unit(rows[has_any], impossible):
            return values
        fields["values"] = shown(impossible)
        self.note(
            code,
            impossible.size,
            np.flatnonzero(rows),
            **fields,
        )
        return np.where(is_impossible, np.nan, values)

    @staticmethod
    def _are_of_another_unit(rows: Mask, impossible: Floats) -> bool:
        """Return whether most rows have impossible readings, and different ones: then the checks blame the unit."""
        return 2 * int(np.count_nonzero(rows)) > rows.size and not stand_for_none(impossible)

    def require_rows(self) -> None:
        """Refuse a role of which nothing stays."""
        if not self.rows.size:
            reasons = "; ".join(note.text for note in self.notes)
            hint = f"to use another topic: {self.role}.topic (`inspect` lists the topics)"
            text = f"no message of {self.time_ns.size} can be used: {reasons}"
            raise LogError(text, hint, *self.table.where)

    def drop_repeated_times(self, *values: Floats) -> None:
        """Keep the first of several rows with the same time.

        Rows with the same time that differ in the values, (k, n), were stamped as they were delivered, several
        together; where these are more than few, it is a warning.
        """
        times = self.times
        again = np.flatnonzero(times[1:] == times[:-1]) + 1
        differ = np.zeros(again.size, np.bool_)
        for array in values:
            differ |= ~same_rows(array[self.rows[again]], array[self.rows[again - 1]])
        count = int(np.count_nonzero(differ))
        if not is_few(count, times.size):
            reason = "messages have the time of the one before, but other values (stamped together on delivery)"
            # Without most of its messages, a topic is not the same any more.
            if count > 0.5 * times.size:
                hint = (
                    f'if the messages have the sensor\'s own time: {self.role}.stamp = "field.path"; '
                    f'to use the recorder\'s time: {self.role}.stamp = "log_time"'
                )
                raise LogError(f"{count} of {times.size} {reason}", hint, *self.table.where)
            good = np.ones(times.size, np.bool_)
            good[again[differ]] = False
            self._keep_rows(good, "same_times", reason=reason)
        self._keep_rows(is_new(self.times), "repeats")

    def drop_repeated_values(self, values: Floats) -> None:
        """Keep the first of consecutive rows with identical values, as a recorder writes that publishes faster."""
        ordered = values[self.rows]
        first = np.ones(len(ordered), np.bool_)
        first[1:] = ~same_rows(ordered[1:], ordered[:-1])
        self._keep_rows(first, "same_values")

    def note_missing(self, quantity: str, values: Floats) -> None:
        """Note the kept rows that lack a quantity (named in the plural) that other rows have."""
        missing = ~np.isfinite(self.kept(values)).all(axis=1)
        count = int(np.count_nonzero(missing))
        if 0 < count < missing.size:
            rows = self.rows[missing]
            self.note(
                "not_finite missing",
                count,
                rows,
                quantity=quantity,
                rows=missing.size,
            )

    def note(
        self,
        code: str,
        count: int,
        first: Rows | None = None,
        severity: Any = None,
        **fields: Any,
    ) -> None:
        """Add a note about some of the rows, with the time of the earliest; its code is without the source.

        Its sentence has the fields ``role`` and ``first``, beside those that are given.
        """
        first_s = 0.0
        if first is not None:
            first_s = float(seconds(self.time_ns[first].min(), self._first_ns))
        fields["role"] = self.role
        fields["first"] = f"the first {first_s:.3f} s after the first message"
        whole_code = f"{self.table.source.code}_{code}"
        self.notes.append(
            note(
                whole_code,
                count,
                severity,
                **fields,
            ).about(self.role)
        )

    def _keep_rows(self, good: Mask, code: str, severity: Any = None, **fields: Any) -> None:
        dropped = int(np.count_nonzero(~good))
        if dropped:
            self.note(
                code,
                dropped,
                self.rows[~good],
                severity,
                **fields,
            )
            self.rows = self.rows[good]


def raise_if_two_dives(table: Table, time_ns: TimeNs) -> None:
    """Refuse a topic of which two files hold different messages of the same time.

    Files may follow one another, fill each other's gaps, or hold the same messages, of which each recorder lost some.
    """
    if table.files is None:
        return
    order = np.lexsort((table.files, time_ns))
    files = table.files[order]
    time_ns = time_ns[order]
    whole = {path: column for path, column in table.columns.items() if len(column) == len(files)}
    values = {path: column[order] for path, column in whole.items() if path not in RECORDER_STAMPS}
    repeated = repeated_rows(values | {"log_time": time_ns[:, None]}, files)
    alone = ~repeated  # messages that no other file has
    alone[:-1] &= ~repeated[1:]
    for file in np.unique(files).tolist():
        own = files == file
        # The time of the file and of all others together.
        first_ns = max(time_ns[own][0], time_ns[~own][0])
        last_ns = min(time_ns[own][-1], time_ns[~own][-1])
        both = (time_ns >= first_ns) & (time_ns <= last_ns)
        ours = int(np.count_nonzero(own & both & alone))
        theirs = int(np.count_nonzero(~own & both & alone))
        # A recorder loses at most 5 %, so that another one alone has them.
        if min(ours, theirs) > max(1.0, 0.05 * np.count_nonzero(both)):
            both_s = (time_ns[both][-1] - time_ns[both][0]) * 1e-9
            text = (
                f"in the {both_s:.3f} s in which the files overlap, one has {ours} messages and the others {theirs} of "
                "the same topic: they are different dives"
            )
            hint = "give only the files of one dive, or replay each file alone, without --one-dive"
            raise LogError(text, hint, *table.where)


def note_lost_samples(cleaner: Cleaner) -> None:
    """Note samples that are missing by the stamps of a regular sensor."""
    steps_ns = np.diff(cleaner.times)
    if not steps_ns.size or steps_ns.max() < 1.5 * steps_ns.mean():
        return  # as of nearly all logs
    stamped = np.flatnonzero(steps_ns)
    step_ns = steps_ns[stamped].astype(np.float64)
    # The lower quartile is the usual step while less than three samples of four are lost. It is the mean of those about
    # it, as stamps may be rounded. Steps within 0.2 of a multiple count as that; of any length, two in five would.
    first_ns = float(np.quantile(step_ns, 0.25))
    in_steps = step_ns / step_ns[np.abs(step_ns / first_ns - 1.0) <= 0.2].mean()
    multiples = np.round(in_steps)
    near = np.abs(in_steps - multiples) <= 0.2
    # Longer pauses are outages, which have a note of their own.
    pauses = (in_steps > 1.5) & (in_steps < 10.5)
    # Fewer than six pauses may be near a multiple by chance, and jitter is near none.
    if np.count_nonzero(pauses) < 6 or near.mean() < 0.8 or near[pauses].mean() < 0.9:
        return
    # Where a rate changes, pauses follow one another; alternating steps do so never; pauses in turn are evenly apart.
    share = pauses.mean()
    distances = np.diff(np.flatnonzero(pauses))
    correlated = abs(np.mean(pauses[1:] & pauses[:-1]) - share**2) > 0.4 * share * (1.0 - share)
    if correlated or distances.std() <= 0.4 * distances.mean():
        return
    lost = int(np.sum(multiples[pauses & near] - 1.0))
    share = lost / (lost + cleaner.times.size)
    usual_s = float(np.median(steps_ns[stamped[~pauses & near]])) / NS_PER_S
    code = "lost_samples"
    if share >= 0.05:  # more may change the results
        code = "lost_samples many"
    first = cleaner.rows[stamped[pauses & near]]
    cleaner.note(
        code,
        lost,
        first,
        share_pct=100.0 * share,
        usual_s=usual_s,
    )


def note_bursts(cleaner: Cleaner, steps_ns: TimeNs, remedy: str) -> None:
    """Note rows that came several at once, so that their times are those of the delivery."""
    # The usual step is none longer than the mean.
    if not steps_ns.size or steps_ns.min() >= 0.2 * steps_ns.mean():
        return
    # Without the pauses in which samples are lost. The median would be that within bursts of more than two samples.
    usual_ns = float(steps_ns[steps_ns <= np.quantile(steps_ns, 0.95)].mean())
    together = np.flatnonzero(steps_ns < 0.2 * usual_ns)
    if together.size <= 0.05 * steps_ns.size:  # by the jitter of stamps that are otherwise regular
        return
    cleaner.note(
        "bursts",
        together.size,
        cleaner.rows[together],
        share=together.size / steps_ns.size,
        usual_s=usual_ns / NS_PER_S,
        remedy=remedy,
    )


def note_gaps(cleaner: Cleaner, pauses_ns: TimeNs, max_gap_s: float) -> None:
    """Note pauses between rows in which several are missing, and steps that are no pause of a dive."""
    max_gap_ns = nanoseconds(max_gap_s)
    is_short = pauses_ns <= max_gap_ns
    short_ns = pauses_ns if is_short.all() else pauses_ns[is_short]
    least_ns: float = max_gap_ns
    if short_ns.size:
        # Five steps are more than the jitter of stamps that come in bursts.
        least_ns = min(5.0 * float(short_ns.mean()), max_gap_ns)
    gaps = np.flatnonzero(pauses_ns > least_ns)
    if not gaps.size:
        return
    long = int(np.count_nonzero(pauses_ns > max_gap_ns))
    code = "gaps"
    if long:
        code = "gaps long"
    cleaner.note(
        code,
        gaps.size,
        cleaner.rows[gaps],
        least_s=least_ns / NS_PER_S,
        longest_s=pauses_ns.max() / NS_PER_S,
        total_s=pauses_ns[gaps].sum() / NS_PER_S,
        long=long,
        max_gap_s=max_gap_s,
    )
    # A recorder without a clock of its own begins in 1970.
    steps = np.flatnonzero(pauses_ns > CLOCK_SET_NS)
    if steps.size:
        around_ns = cleaner.times[steps[0] : steps[0] + 2]
        before, after = around_ns.astype("M8[ns]").astype("M8[s]")
        cleaner.note(
            "clock_set",
            steps.size,
            cleaner.rows[steps],
            before=before,
            after=after,
        )
