"""Rows made clean: in the order of time, each time once, every number finite; and a note of every loss."""

from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, TimeNs, seconds
from insdvl_replay.errors import LogError, Note, Severity

GAP_STEPS: Final = 5.0
"""A pause of this many steps is more than the jitter of stamps that come in bursts."""

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]
Scalar = TypeVar("Scalar", bound=np.generic)


FEW: Final = 0.05
"""Faults are single; where a larger share of the readings is impossible, something else is wrong with all of them."""


@dataclass
class Cleaner:
    """Chooses the rows of a role that stay, and remembers why the others went.

    Parameters
    ----------
    role : str
        Begins the codes of the notes.
    time_ns : ndarray, shape (k,)
        Times of validity in the order of the file.

    Attributes
    ----------
    rows : ndarray, shape (kept,)
        Indices of the rows that stay, in the order of time.
    notes : list of Note
    """

    role: str
    time_ns: TimeNs
    rows: Rows = field(init=False)
    notes: list[Note] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rows = np.argsort(self.time_ns, kind="stable")
        latest = np.maximum.accumulate(self.time_ns)
        late = np.flatnonzero(self.time_ns < latest)
        if late.size:
            worst_s = float(seconds(latest, self.time_ns).max())
            self.note("out_of_order", f"messages came after later ones (by up to {worst_s:.3f} s); sorted", late.size)

    @property
    def times(self) -> TimeNs:
        """The times of the rows that stay."""
        return self.kept(self.time_ns)

    def kept(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Give the rows that stay, in the order of time.

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

    def keep(self, good: Mask, code: str, reason: str, severity: Severity = "info") -> None:
        """Drop the rows that are not good.

        Parameters
        ----------
        good : ndarray of bool, shape (k,)
            For each row of the file.
        code, reason : str
            End of the note's code, and what the dropped messages are like.
        severity : {'info', 'warning'}
        """
        self._keep_rows(good[self.rows], code, reason, severity)

    def keep_finite(self, *values: Floats) -> None:
        """Drop the rows in which a number is missing.

        Parameters
        ----------
        *values : ndarray, shape (k, n)
            For each row of the file.
        """
        finite = np.ones(self.time_ns.size, np.bool_)
        for column in (column for array in values for column in array.T):
            finite &= np.isfinite(column)
        self.keep(finite, "not_finite", "messages hold a number that is not finite")

    def keep_possible(self, possible: Mask, reason: str) -> None:
        """Drop the few rows that no sensor can have meant; where they are many, the unit is wrong, and is told as such.

        Parameters
        ----------
        possible : ndarray of bool, shape (k,)
            For each row of the file.
        reason : str
            What the dropped messages are like.
        """
        few = possible.size - np.count_nonzero(possible) <= FEW * possible.size
        if few:
            self.keep(possible, "impossible", reason, "warning")

    def require_rows(self, place: str) -> None:
        """Refuse a role of which nothing stays.

        Parameters
        ----------
        place : str
            File and topic.

        Raises
        ------
        LogError
        """
        if not self.rows.size:
            reasons = "; ".join(note.text for note in self.notes)
            raise LogError(f"{place}: no message of {self.time_ns.size} can be used: {reasons}", "see `inspect`")

    def drop_repeated_times(self) -> None:
        """Keep the first of several rows with the same time."""
        times = self.times
        first = np.ones(times.size, np.bool_)
        first[1:] = times[1:] != times[:-1]
        self._keep_rows(first, "repeats", "messages repeat the time of the one before", "info")

    def drop_repeated_values(self, values: Floats) -> None:
        """Keep the first of consecutive rows with identical values, as a recorder writes that publishes faster.

        Parameters
        ----------
        values : ndarray, shape (k, n)
            For each row of the file.
        """
        ordered = values[self.rows]
        same = (ordered[1:] == ordered[:-1]) | (np.isnan(ordered[1:]) & np.isnan(ordered[:-1]))
        first = np.ones(len(ordered), np.bool_)
        first[1:] = ~same.all(axis=1)
        self._keep_rows(first, "same_values", "messages repeat the values of the one before", "info")

    def note_gaps(self, max_gap_s: float) -> None:
        """Note pauses between rows in which several are missing.

        Parameters
        ----------
        max_gap_s : float
            Pauses up to this count as harmless.
        """
        times = self.times
        pauses_s = seconds(times[1:], times[:-1])
        short_s = pauses_s[pauses_s <= max_gap_s]
        least_s = min(GAP_STEPS * float(short_s.mean()), max_gap_s) if short_s.size else max_gap_s
        gaps = np.flatnonzero(pauses_s > least_s)
        if not gaps.size:
            return
        long = int(np.count_nonzero(pauses_s > max_gap_s))
        text = (
            f"gaps are longer than {least_s:.3g} s, the first at {float(seconds(times[gaps[:1]], times[0])[0]):.3f} s, "
            f"the longest of {pauses_s.max():.3f} s, {pauses_s[gaps].sum():.3f} s in all; "
            f"{long} longer than {max_gap_s:g} s"
        )
        hint = f"{self.role}.max_gap_s says which are harmless" if long else ""
        self.note("gaps", text, gaps.size, "warning" if long else "info", hint)

    def note(self, code: str, text: str, count: int, severity: Severity = "info", hint: str = "") -> None:
        """Add a note about some of the rows.

        Parameters
        ----------
        code, text : str
            Without the role and the count, which stand in front of them.
        count : int
        severity : {'info', 'warning'}
        hint : str
        """
        self.notes.append(Note(f"{self.role}_{code}", f"{self.role}: {count} {text}", count, severity, hint))

    def _keep_rows(self, good: Mask, code: str, reason: str, severity: Severity) -> None:
        dropped = int(np.count_nonzero(~good))
        if dropped:
            self.note(code, f"{reason}; dropped", dropped, severity)
            self.rows = self.rows[good]
