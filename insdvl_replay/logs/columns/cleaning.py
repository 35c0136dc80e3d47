"""Rows made clean: in the order of time, each time once, every number finite; and a note of every loss."""

from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import Floats, TimeNs, is_new, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.clocks import SAME_CLOCK_S
from insdvl_replay.logs.columns.order import Mask, Order, Rows, find_order, raise_if_two_dives
from insdvl_replay.logs.columns.tables import Table

Scalar = TypeVar("Scalar", bound=np.generic)

FEW: Final = 0.05
"""Faults are single; where a larger share of the readings is impossible, something else is wrong with all of them."""
MOST: Final = 0.5
"""A topic that loses a larger share of its messages is not the same any more."""


def is_few(count: int, size: int) -> bool:
    """Return whether faults are single ones: one, or a small share of all."""
    return count <= max(1.0, FEW * size)


def same_rows(rows: Floats, others: Floats) -> Mask:
    """Find which rows are identical, where NaN is the same as NaN."""
    return np.asarray(((rows == others) | (np.isnan(rows) & np.isnan(others))).all(axis=1))


@dataclass
class Cleaner:
    """Chooses the rows of a topic that stay, and remembers why the others went.

    Parameters
    ----------
    table : Table
        The messages of one topic, whose role begins the codes of the notes.

    Attributes
    ----------
    time_ns : ndarray, shape (k,)
        Times of validity in the order of the file.
    rows : ndarray, shape (kept,)
        Indices of the rows that stay, in the order of time.

    Raises
    ------
    LogError
        The stamps contradict the recorder's clock in more than single messages, or two files hold different messages
        of the same time.
    """

    table: Table
    time_ns: TimeNs = field(init=False)
    rows: Rows = field(init=False)
    notes: list[Note] = field(default_factory=list)
    _first_ns: int = field(init=False)

    def __post_init__(self) -> None:
        self.time_ns, log_time_ns = self.table.time_ns(), self.table.columns["log_time"][:, 0]
        raise_if_two_dives(self.table, self.time_ns)
        order = find_order(self.time_ns, log_time_ns)
        self.rows, self._first_ns = order.rows, int(self.time_ns[order.rows[0]])
        if order.wrong.size:
            self._note_wrong_stamps(order, float(seconds(log_time_ns[order.wrong], log_time_ns.min()).min()))
        if order.late.size:
            text = f"messages came after later ones (by up to {order.late_s:.3f} s); sorted"
            self.note("out_of_order", text, order.late.size, first=order.late)

    @property
    def times(self) -> TimeNs:
        """The times of the rows that stay."""
        return self.kept(self.time_ns)

    @property
    def role(self) -> str:
        """The role of the topic."""
        return self.table.source.role

    @property
    def stamp_hint(self) -> str:
        """What helps where the stamps are those of a delivery."""
        return f'{self.role}.stamp = "field.path" names the time of the sensor itself, if the messages hold it'

    def kept(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return the rows that stay, in the order of time.

        Parameters
        ----------
        values : ndarray, shape (k, ...)
            For each row of the file.

        Returns
        -------
        ndarray, shape (kept, ...)
            The very same array where all rows stay in place, which spares large logs a copy.
        """
        # No row is dropped or moved without a note.
        return values[self.rows] if self.notes else values

    def keep(self, good: Mask, code: str, reason: str, severity: Severity = Severity.INFO, hint: str = "") -> None:
        """Drop the rows that are not good.

        Parameters
        ----------
        good : ndarray of bool, shape (k,)
            For each row of the file.
        code, reason : str
            End of the note's code, and what the dropped messages are like.
        severity : {'info', 'warning'}
        """
        self._keep_rows(good[self.rows], code, reason, severity, hint)

    def keep_finite(self, *values: Floats, hint: str = "") -> None:
        """Drop the rows in which a number is missing.

        Parameters
        ----------
        *values : ndarray, shape (k, n)
            For each row of the file.
        hint : str
            Where given, numbers are expected in each row, and it is a warning that more than single ones lack them.
        """
        # The extremes of a column of which a number is missing are missing.
        if all(np.isfinite([array.min(), array.max()]).all() for array in values if array.size):
            return
        finite = np.ones(self.time_ns.size, np.bool_)
        for column in (column for array in values for column in array.T):
            finite &= np.isfinite(column)
        lost = ~finite[self.rows]
        single = not np.any(lost[1:] & lost[:-1])
        severity: Severity = Severity.WARNING if hint and not single else Severity.INFO
        self.keep(finite, "not_finite", "messages hold a number that is not finite", severity, hint)

    def keep_possible(self, possible: Mask, reason: str, hint: str) -> None:
        """Drop the few rows that no sensor can have meant; where they are many, the unit is wrong, and is told as such.

        Parameters
        ----------
        possible : ndarray of bool, shape (k,)
            For each row of the file.
        reason : str
            What the dropped messages are like.
        """
        if is_few(int(np.count_nonzero(~possible)), possible.size):
            self.keep(possible, "impossible", reason, Severity.WARNING, hint)

    def require_rows(self) -> None:
        """Refuse a role of which nothing stays."""
        if not self.rows.size:
            reasons = "; ".join(note.text for note in self.notes)
            hint = f"`inspect` lists the topics; {self.role}.topic names another one"
            raise LogError(f"no message of {self.time_ns.size} can be used: {reasons}", hint, *self.table.where)

    def drop_repeated_times(self, *values: Floats) -> None:
        """Keep the first of several rows with the same time.

        Parameters
        ----------
        *values : ndarray, shape (k, n)
            For each row of the file. Rows with the same time that differ in them were stamped as they were delivered,
            several together; where these are more than few, it is a warning.
        """
        times = self.times
        again = np.flatnonzero(times[1:] == times[:-1]) + 1
        differ = np.zeros(again.size, np.bool_)
        for array in values:
            differ |= ~same_rows(array[self.rows[again]], array[self.rows[again - 1]])
        several = int(np.count_nonzero(differ))
        if not is_few(several, times.size):
            good = np.ones(times.size, np.bool_)
            good[again[differ]] = False
            self._drop_stamped_together(good, several)
            times = self.times
        self._keep_rows(is_new(times), "repeats", "messages repeat the time of the one before")

    def drop_repeated_values(self, values: Floats) -> None:
        """Keep the first of consecutive rows with identical values, as a recorder writes that publishes faster.

        Parameters
        ----------
        values : ndarray, shape (k, n)
            For each row of the file.
        """
        ordered = values[self.rows]
        first = np.ones(len(ordered), np.bool_)
        first[1:] = ~same_rows(ordered[1:], ordered[:-1])
        self._keep_rows(first, "same_values", "messages repeat the values of the one before")

    def note_missing(self, quantity: str, values: Floats) -> None:
        """Count the rows that stay without a quantity which others of them give.

        Parameters
        ----------
        quantity : str
            In the plural.
        values : ndarray, shape (k, n)
            For each row of the file.
        """
        missing = ~np.isfinite(values[self.rows]).all(axis=1)
        count = int(np.count_nonzero(missing))
        if 0 < count < missing.size:
            text = f"{quantity} of {missing.size} are not finite, and count as missing"
            self.note("not_finite", text, count, first=self.rows[missing])

    def note(
        self,
        code: str,
        text: str,
        count: int,
        severity: Severity = Severity.INFO,
        hint: str = "",
        first: Rows | None = None,
    ) -> None:
        """Add a note about some of the rows."""
        first_s = 0.0 if first is None else float(seconds(self.time_ns[first].min(), self._first_ns))
        since = f"the first {first_s:.3f} s after the first message"
        self.notes.append(Note(f"{self.role}_{code}", f"{self.role}: {count} {text}; {since}", count, severity, hint))

    def _note_wrong_stamps(self, order: Order, first_s: float) -> None:
        """Drop single stamps that are wrong with a warning; refuse many, and those of a clock that was set back."""
        text = (
            f"{order.wrong.size} of {self.time_ns.size} messages have stamps '{self.table.source.stamp}' that jump "
            f"while the log time goes on; the first {first_s:.3f} s after the first message"
        )
        hint = f'{self.role}.stamp = "log_time"'
        if order.jump_s > SAME_CLOCK_S:
            raise LogError(f"{text}; their clock was set back by {order.jump_s:.3f} s", hint, *self.table.where)
        if not is_few(order.wrong.size, self.time_ns.size):
            raise LogError(text, hint, *self.table.where)
        self.notes.append(
            Note(f"{self.role}_wrong_stamps", f"{self.role}: {text}; dropped", order.wrong.size, Severity.WARNING, hint)
        )

    def _drop_stamped_together(self, good: Mask, count: int) -> None:
        """Drop the rows that have the time of the one before and other values; refuse to drop most of a topic."""
        reason = "messages have the time of the one before and other values, as if several were stamped together"
        if count > MOST * good.size:
            raise LogError(
                f"{count} of {good.size} {reason}",
                f'{self.stamp_hint}; {self.role}.stamp = "log_time" takes the recorder\'s',
                *self.table.where,
            )
        self._keep_rows(good, "same_times", reason, Severity.WARNING, self.stamp_hint)

    def _keep_rows(
        self, good: Mask, code: str, reason: str, severity: Severity = Severity.INFO, hint: str = ""
    ) -> None:
        dropped = int(np.count_nonzero(~good))
        if dropped:
            self.note(code, f"{reason}; dropped", dropped, severity, hint, first=self.rows[~good])
            self.rows = self.rows[good]
