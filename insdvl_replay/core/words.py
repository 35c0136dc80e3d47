"""The words of results: every verdict, status, severity and change. Their values are used in files and scripts."""

from enum import StrEnum


class Consistency(StrEnum):
    """Whether innovations, or errors against a reference, are as large as a filter predicts."""

    CONSISTENT = "consistent"
    CONSERVATIVE = "conservative"
    OVERCONFIDENT = "overconfident"
    NOT_FINITE = "not finite"
    INSUFFICIENT = "insufficient data"
    NOT_IN_REFERENCE = "not in reference"
    NO_REFERENCE = "no reference"
    # An onboard solution without innovations or covariance; or a filter lacks states for a held-out sensor.
    NOT_AVAILABLE = "not available"


class Reason(StrEnum):
    """Why a verdict of `Consistency` differs from the interval of the mean."""

    NONE = ""
    NEAR = "near"  # Outside, but so near that it does not matter.
    # Below: a filter that starts on the reference has smaller errors than its sigma for a while.
    EXACT_START = "exact start"
    # Below, but a lasting error is one sample and may be small by chance.
    ONE_SAMPLE = "one sample"
    BEYOND_3_SD = "beyond 3 sd"  # Inside, but more than chance allows.


class Whiteness(StrEnum):
    """Whether innovations are white, as those of an optimal filter."""

    WHITE = "white"
    CORRELATED = "correlated"
    INSUFFICIENT = "insufficient data"
    NOT_FINITE = "not finite"


class EvidenceVerdict(StrEnum):
    """The word of one ratio over several dives, by its interval and the band of a factor 1.05 to each side of 1."""

    BETTER = "better"  # The interval is wholly left of the band.
    # Wholly inside; or a proof shows that the ratio cannot leave the band.
    EQUIVALENT = "equivalent"
    UNDECIDED = "undecided"
    WORSE = "worse"  # Wholly right.


class Settling(StrEnum):
    """The second answer: whether a candidate settles sooner from drawn starts, by the same rule."""

    SOONER = "sooner"
    SAME = "same"
    UNDECIDED = "undecided"
    LATER = "later"


class Role(StrEnum):
    """What a row of evidence may do for the verdict."""

    # It is the one quantity that decides; in the rows of a dive: it may become that.
    PRIMARY = "primary"
    SECONDARY = "secondary"  # It can warn, and cannot win.
    VETO = "veto"  # It can turn better into mixed on its own, and makes no other word.
    SETTLING = "settling"  # It gives the second answer.
    SHOWN = "shown"


class Verdict(StrEnum):
    """The verdict on a candidate, by its primary quantity."""

    BETTER = "better"
    BETTER_WITHOUT_DVL = "better without DVL"  # The primary quantity is the drift in DVL outages.
    EQUIVALENT = "equivalent"
    EQUIVALENT_WITHOUT_DVL = "equivalent without DVL"
    NO_EFFECT = "no effect"  # No error of the baseline is changed by 1 %.
    UNDECIDED = "undecided"
    # The primary quantity is better, and another is surely worse; or the word depends on the heading at the start.
    MIXED = "mixed"
    WORSE_WITHOUT_DVL = "worse without DVL"
    WORSE = "worse"
    # The candidate's answer differs from run to run, or by changes of its input that mean nothing.
    NOT_REPEATABLE = "not repeatable"
    # The candidate or the baseline diverged or is misconfigured, so their numbers cannot be compared.
    NOT_EVALUATED = "not evaluated"


class ReasonCode(StrEnum):
    """Why the answer over several dives is no plain word of its primary quantity; empty where it is."""

    NONE = ""
    ONE_DIVE = "one dive"
    FEW_DIVES = "few dives"
    NO_PRIMARY = "no primary quantity"
    NOISE = "noise of the reference"  # It is most of the errors, which are equal.
    WIDE = "wide interval"
    WARNING = "warning"  # Another quantity, which can warn, is worse.
    START = "heading at the start"  # The two starts contradict each other.
    VEHICLES = "vehicles"  # Two vehicles contradict each other.
    EXCLUDED = "dives not evaluated"  # At least half of them.


class HeadingSource(StrEnum):
    """Where the heading at the start comes from."""

    REFERENCE = "reference"
    SENSOR = "sensor"
    FIT = "fit"  # to positions of the reference
    SETTINGS = "settings"


class Prediction(StrEnum):
    """Whether the predicted improvement of a candidate was measured."""

    CONFIRMED = "confirmed"
    UNDECIDED = "undecided"
    NOT_CONFIRMED = "not confirmed"


class ImprovementStatus(StrEnum):
    """Change of a standard deviation at the end of the dive."""

    IMPROVED = "improved"
    SAME = "same"
    WORSE = "worse"
    NOT_FINITE = "not finite"


class ConvergenceStatus(StrEnum):
    """Whether the sigma of a candidate stays below the final sigma of the baseline."""

    REACHED = "reached"
    AT_START = "at_start"
    NEVER = "never"
    NOT_MEASURED = "not measured"  # No reference or truth has the error, or no start was drawn.


class ReferenceStatus(StrEnum):
    """Whether an error against the reference can be used."""

    COMPARED = "compared"
    NO_REFERENCE = "no reference"
    NOT_IN_REFERENCE = "not in reference"
    # The candidate is an onboard solution without this quantity at the times of the reference.
    NOT_IN_SOLUTION = "not in solution"
    NO_DISTANCE = "no distance"
    # The reference has the quantity only in a part of the replay.
    PARTLY_COVERED = "partly covered"
    LOST_IN_GAP = "lost in gap"  # The position was lost in a long IMU gap.


class DelayStatus(StrEnum):
    """Whether the delay of a reference against the IMU is known."""

    DETERMINED = "determined"
    # Turns and accelerations have different delays; the larger one is given.
    CONTRADICTORY = "contradictory"
    # The vehicle moves too little, or the reference is too coarse.
    LITTLE_MOTION = "little motion"
    NO_ATTITUDE = "no attitude"  # Without one, turns and accelerations cannot be compared.
    NO_REFERENCE = "no reference"


class DirectionStatus(StrEnum):
    """How well measurements determine a direction of the error state."""

    UNOBSERVABLE = "unobservable"
    WEAK = "weak"
    SEEN = "seen"


class Severity(StrEnum):
    """Whether a note may affect the trust in the tables."""

    INFO = "info"
    WARNING = "warning"  # ``--strict`` makes it an error.


class Reading(StrEnum):
    """How much of a log was read to inspect it."""

    SUMMARY = "summary"
    SAMPLE = "sample"
    WHOLE = "whole"


class GateLevel(StrEnum):
    """The effect of a failed gate."""

    ERROR = "error"
    WARN = "warn"
    OFF = "off"


class GateStatus(StrEnum):
    """The result of a gate on a dive, in the order of a check's list."""

    UNUSABLE = "unusable"  # The dive could not be replayed, or its result could not be read.
    FAILED = "failed"
    WARNING = "warning"
    OFF = "off"
    PASSED = "passed"


class ChangeVerdict(StrEnum):
    """The change of a value, in the order of a comparison's counts."""

    BETTER = "better"
    WORSE = "worse"
    SAME = "same"
    CHANGED = "changed"  # Neither better nor worse, and not the same.
    NEW = "new"  # Only the new side has it.
    GONE = "gone"  # Only the old side has it.


class MatchedBy(StrEnum):
    """How the dive on the other side was found."""

    HASH = "hash"
    NAME = "name"
    CHOICE = "choice"  # Each side is a single result.
    NOTHING = "nothing"  # There is none.


class Estimated(StrEnum):
    """The result of a calibration for a parameter."""

    ESTIMATED = "estimated"
    HELD = "held"  # It cannot be determined from these dives and is unchanged.
    IMPLAUSIBLE = "implausible"  # The estimate cannot be right and is not proposed.
    # A noise that these dives determine only to more than a factor of two.
    NOT_DETERMINED = "not determined"
    OF_CLASS = "of class"  # A noise that these dives contradict but do not determine: that of the class of the IMU.
    NOT_ASKED = "not asked"


def known_words() -> frozenset[str]:
    """Return the values of all enumerations of this module: what a column of words may hold."""
    words = set[str]()
    for kind in globals().values():
        if isinstance(kind, type) and issubclass(kind, StrEnum):
            words.update(kind)
    return frozenset(words)
