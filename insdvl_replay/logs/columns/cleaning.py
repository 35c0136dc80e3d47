"""Rows made clean: in the order of time, each time once, every number finite; and a note of every loss.

A log does not say what never came into it. Its stamps do where a sensor is regular: then pauses are two, three or more
usual steps, and nothing between. Where stamps jitter, come in bursts or follow a rate that changes, pauses are of any
length, or of one length in a row or at even distances, and nothing is said of samples that are lost one by one.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, Scalar, TimeNs, is_new, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.order import Mask, Order, Rows, find_order, raise_if_two_dives
from insdvl_replay.logs.columns.tables import SAME_CLOCK_S, Table

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

    Values, and masks of good rows, have one row for each of the k messages in the file.

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
        """Return of values, shape (k, ...), those of the rows that stay, in the order of time, shape (kept, ...).

        Where all rows stay in place it is the very same array, which spares large logs a copy.
        """
        # No row is dropped or moved without a note.
        return values[self.rows] if self.notes else values

    def keep(self, good: Mask, code: str, reason: str, severity: Severity = Severity.INFO, hint: str = "") -> None:
        """Drop the rows that are not good; the reason says what the dropped messages are like."""
        self._keep_rows(good[self.rows], code, reason, severity, hint)

    def keep_finite(
        self, *values: Floats, hint: str = "", reason: str = "messages hold a number that is not finite"
    ) -> None:
        """Drop the rows in which a number of some columns, shape (k, n), is missing.

        With a hint, numbers are expected in each row, and it is a warning that more than single ones lack them.
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
        self.keep(finite, "not_finite", reason, severity, hint)

    def keep_possible(self, possible: Mask, reason: str, hint: str) -> None:
        """Drop the few rows that no sensor can have meant; where there are many, the unit is wrong, and is told."""
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

        Rows with the same time that differ in the values, shape (k, n), were stamped as they were delivered, several
        together; where these are more than few, it is a warning.
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
        """Keep the first of consecutive rows with identical values, as a recorder writes that publishes faster."""
        ordered = values[self.rows]
        first = np.ones(len(ordered), np.bool_)
        first[1:] = ~same_rows(ordered[1:], ordered[:-1])
        self._keep_rows(first, "same_values", "messages repeat the values of the one before")

    def note_missing(self, quantity: str, values: Floats) -> None:
        """Count the rows that stay without a quantity, named in the plural, which others of them give."""
        missing = ~np.isfinite(self.kept(values)).all(axis=1)
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
        self.notes.append(
            Note(f"{self.table.source.code}_{code}", f"{self.role}: {count} {text}; {since}", count, severity, hint)
        )

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
            Note(
                f"{self.table.source.code}_wrong_stamps",
                f"{self.role}: {text}; dropped",
                order.wrong.size,
                Severity.WARNING,
                hint,
            )
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


_USUAL: Final = 0.25
"""Quantile of the steps that is the usual one while less than three samples of four are lost."""
_NEAR: Final = 0.2
"""Steps that are so near a multiple of the usual one count as that; two in five of any length would."""
_MOST_NEAR: Final = 0.8
"""Share of the steps that must be near a multiple."""
_MOST_PAUSES_NEAR: Final = 0.9
"""The same of the pauses among them."""
_PAUSE: Final = 1.5
"""From so many usual steps on a step is a pause."""
_LONGEST: Final = 10.5
"""Up to so many; longer ones are outages, which are told as such."""
_LEAST_PAUSES: Final = 6
"""Fewer pauses may be near a multiple by chance."""
_LIKE_THE_LAST: Final = 0.4
"""Correlation of pauses with those a step later: above it the rate changes, below minus it steps alternate."""
_EVEN: Final = 0.4
"""Spread over mean of the distances between pauses, below which they come in turn: at random it is 0.7 or more."""
_MUCH: Final = 0.05
"""Share of lost samples from which it may change how far a result is to be believed."""
_HINT: Final = "what was not recorded cannot be replayed: look for a recorder or a network that cannot follow"


def note_lost_samples(cleaner: Cleaner) -> None:
    """Note samples for which stamps leave a place, but which the log does not hold."""
    steps_ns = np.diff(cleaner.times)
    if not steps_ns.size or steps_ns.max() < _PAUSE * steps_ns.mean():
        return  # as of nearly all logs
    stamped = np.flatnonzero(steps_ns)
    in_steps = _in_usual_steps(steps_ns[stamped].astype(np.float64))
    multiples = np.round(in_steps)
    near = np.abs(in_steps - multiples) <= _NEAR
    pauses = (in_steps > _PAUSE) & (in_steps < _LONGEST)
    if not _are_losses(near, pauses):
        return
    lost = int(np.sum(multiples[pauses & near] - 1.0))
    share = lost / (lost + cleaner.times.size)
    usual_s = float(np.median(steps_ns[stamped[~pauses & near]])) / NS_PER_S
    text = (
        f"samples, {100.0 * share:.2g} % of all, are not in the log: pauses are multiples of the usual {usual_s:.4g} s"
    )
    much = share >= _MUCH
    first = cleaner.rows[stamped[pauses & near]]
    cleaner.note(
        "lost_samples", text, lost, Severity.WARNING if much else Severity.INFO, _HINT if much else "", first=first
    )


def _in_usual_steps(steps_ns: Floats) -> Floats:
    """Divide steps by the usual one: the mean of those about the quantile, since stamps may be rounded."""
    first = float(np.quantile(steps_ns, _USUAL))
    return np.asarray(steps_ns / steps_ns[np.abs(steps_ns / first - 1.0) <= _NEAR].mean())


def _are_losses(near: Mask, pauses: Mask) -> bool:
    """Distinguish losses at random from jitter, from a rate that changes and from pauses that come in turn."""
    count = int(np.count_nonzero(pauses))
    if count < _LEAST_PAUSES or near.mean() < _MOST_NEAR or near[pauses].mean() < _MOST_PAUSES_NEAR:
        return False
    share = pauses.mean()
    if abs(np.mean(pauses[1:] & pauses[:-1]) - share**2) > _LIKE_THE_LAST * share * (1.0 - share):
        return False
    distances = np.diff(np.flatnonzero(pauses))
    return bool(distances.std() > _EVEN * distances.mean())


BURST_STEP: Final = 0.2
"""Share of the usual step below which two samples came together, and were not taken so."""
PAUSES: Final = 0.95
"""Share of steps that are no pauses, in which samples are lost."""
BURSTS: Final = 0.05
"""Share of steps that may be so short by the jitter of stamps that are otherwise regular."""


def note_bursts(cleaner: Cleaner, steps_ns: TimeNs, remedy: str) -> None:
    """Note rows that came several at once, so that their times are those of the delivery."""
    # The usual step is none longer than the mean.
    if not steps_ns.size or steps_ns.min() >= BURST_STEP * steps_ns.mean():
        return
    # The median would be that within the bursts, where more than two samples come at once.
    usual_ns = float(steps_ns[steps_ns <= np.quantile(steps_ns, PAUSES)].mean())
    together = np.flatnonzero(steps_ns < BURST_STEP * usual_ns)
    if together.size <= BURSTS * steps_ns.size:
        return
    text = (
        f"samples, {together.size / steps_ns.size:.0%} of all, are stamped less than {BURST_STEP:g} of the usual "
        f"step of {usual_ns / NS_PER_S:.4f} s after the one before: stamps in bursts are those of a delivery"
    )
    hint = f"{cleaner.stamp_hint}; else raise {remedy} until the mean NIS is that of a consistent filter"
    cleaner.note("bursts", text, together.size, Severity.WARNING, hint, first=cleaner.rows[together])
