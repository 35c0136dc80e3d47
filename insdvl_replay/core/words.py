"""The words of results: every verdict, status, severity and change, once. Their values stand in files and scripts."""

from enum import StrEnum


class Consistency(StrEnum):
    """Whether innovations, or errors against a reference, are as large as a filter says."""

    CONSISTENT = "consistent"
    CONSERVATIVE = "conservative"
    OVERCONFIDENT = "overconfident"
    NOT_FINITE = "not finite"
    INSUFFICIENT = "insufficient data"
    NOT_IN_REFERENCE = "not in reference"
    NO_REFERENCE = "no reference"
    # A solution that was read has no innovations, or no covariance; or a filter lacks states for a withheld sensor.
    NOT_AVAILABLE = "not available"


class Reason(StrEnum):
    """Why a verdict of `Consistency` is not what the interval of the mean says."""

    NONE = ""
    NEAR = "within 10 %"  # Outside, but so near to what is expected that it does not matter.
    # Below: a filter that starts on the reference errs less than it allows for, for as long as it remembers that.
    EXACT_START = "as from an exact start"
    # Below, but an error of the filter that stays tells of itself once, and may be small by chance.
    ONE_SAMPLE = "a difference that stays is one sample"
    BEYOND_3_SD = "many beyond 3 sd"  # Inside, but more errors than chance allows are beyond three standard deviations.


class Whiteness(StrEnum):
    """Whether innovations have used all that a measurement could tell."""

    WHITE = "white"
    CORRELATED = "correlated"
    INSUFFICIENT = "insufficient data"
    NOT_FINITE = "not finite"


class EvidenceVerdict(StrEnum):
    """What one piece of evidence says of a candidate beside the baseline."""

    BETTER = "better"
    EQUIVALENT = "equivalent"  # As good within the margin, and that is sure.
    UNDECIDED = "undecided"  # The dive holds too little to tell.
    WORSE = "worse"


class Verdict(StrEnum):
    """What all evidence says of a candidate beside the baseline."""

    BETTER = "better"  # In something, and in nothing worse.
    EQUIVALENT = "equivalent"
    UNDECIDED = "undecided"
    MIXED = "mixed"
    WORSE = "worse"
    # The candidate, or the baseline, is dead or set wrong: its numbers say nothing of gain or loss.
    NOT_EVALUATED = "not evaluated"


class Prediction(StrEnum):
    """Whether what was measured bears out what a candidate believes to have gained."""

    CONFIRMED = "confirmed"
    UNDECIDED = "undecided"
    NOT_CONFIRMED = "not confirmed"


class ImprovementStatus(StrEnum):
    """What became of a standard deviation at the end of the dive."""

    IMPROVED = "improved"
    SAME = "same"
    WORSE = "worse"
    NOT_FINITE = "not finite"


class ConvergenceStatus(StrEnum):
    """Whether a candidate becomes, and stays, as sure as the baseline is at the end."""

    REACHED = "reached"
    AT_START = "at_start"
    NEVER = "never"
    NOT_MEASURED = "not measured"  # No reference, or truth, knows the error, or no start was drawn.


class ReferenceStatus(StrEnum):
    """Whether an error against the reference says something of the filters."""

    COMPARED = "compared"
    NO_REFERENCE = "no reference"
    NOT_IN_REFERENCE = "not in reference"
    # The candidate is a solution that was read, and says nothing of it where the reference does.
    NOT_IN_SOLUTION = "not in solution"
    NO_DISTANCE = "no distance"
    PARTLY_COVERED = "partly covered"  # The reference knows the quantity in a part of the replay alone.
    LOST_IN_GAP = "lost in gap"  # The IMU was silent for long, and nothing brings the position back.


class DirectionStatus(StrEnum):
    """What measurements show of a direction of the error state."""

    UNOBSERVABLE = "unobservable"
    WEAK = "weak"
    SEEN = "seen"


class Severity(StrEnum):
    """Whether a note may change how far the tables are to be believed."""

    INFO = "info"
    WARNING = "warning"  # ``--strict`` makes it an error.


class Reading(StrEnum):
    """How much of the messages was read to know a log."""

    SAMPLE = "sample"
    WHOLE = "whole"


class GateLevel(StrEnum):
    """What a gate that is not passed does."""

    ERROR = "error"
    WARN = "warn"
    OFF = "off"


class GateStatus(StrEnum):
    """What became of a gate on a dive, in the order in which a check lists it."""

    UNUSABLE = "unusable"  # The dive could not be replayed, or its result not be read.
    FAILED = "failed"
    WARNING = "warning"
    OFF = "off"
    PASSED = "passed"


class ChangeVerdict(StrEnum):
    """What became of a cell, in the order in which a comparison counts it."""

    BETTER = "better"
    WORSE = "worse"
    SAME = "same"
    CHANGED = "changed"  # Neither better nor worse, and not the same.
    NEW = "new"  # Only the new side has it.
    GONE = "gone"  # Only the old side has it.


class MatchedBy(StrEnum):
    """How the counterpart of a dive was found."""

    HASH = "hash"
    NAME = "name"
    CHOICE = "choice"  # Each side is a single result, so that the two were meant.
    NOTHING = "nothing"  # It has none.


class Estimated(StrEnum):
    """What a calibration did with a parameter."""

    ESTIMATED = "estimated"
    HELD = "held"  # The dives do not show it: it stays as it was, to the bit.
    IMPLAUSIBLE = "implausible"  # What was found cannot be right, and is not proposed.
    NOT_DETERMINED = "not determined"  # A noise that these dives do not tell to a factor of two.
    NOT_ASKED = "not asked"
