"""The words of the tables: every verdict and status, once. Their values stand in files, gates and scripts."""

from enum import StrEnum


class Consistency(StrEnum):
    """Whether innovations, or errors against a reference, are as large as a filter says."""

    CONSISTENT = "consistent"
    OVER_CAUTIOUS = "over-cautious"
    OVER_CONFIDENT = "over-confident"
    NOT_FINITE = "not finite"
    TOO_FEW = "too few"
    NOT_IN_REFERENCE = "not in reference"
    NO_REFERENCE = "no reference"


class Whiteness(StrEnum):
    """Whether innovations have used all that a measurement could tell."""

    WHITE = "white"
    CORRELATED = "correlated"
    TOO_FEW = "too few"
    NOT_FINITE = "not finite"


class Gain(StrEnum):
    """Whether the reference bears out what a candidate believes to have gained."""

    BORNE_OUT = "borne out"
    NONE_BELIEVED = "none believed"
    NOT_BORNE_OUT = "not borne out"
    WORSE = "worse"
    NOT_JUDGED = "not judged"
    """The candidate, or the baseline, is dead: its numbers say nothing of gain or loss."""
    NO_REFERENCE = "no reference"


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


class ReferenceStatus(StrEnum):
    """Whether an error against the reference says something of the filters."""

    COMPARED = "compared"
    NO_REFERENCE = "no reference"
    NOT_IN_REFERENCE = "not in reference"
    NO_DISTANCE = "no distance"
    PARTLY_COVERED = "partly covered"
    """The reference knows the quantity in a part of the replay alone."""
    LOST_IN_GAP = "lost in gap"
    """The IMU was silent for long, and nothing brings the position back."""


class DirectionStatus(StrEnum):
    """What measurements show of a direction of the error state."""

    UNOBSERVABLE = "unobservable"
    WEAK = "weak"
    SEEN = "seen"
