"""A calibration of dives, from their logs to the settings that it proposes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from insdvl_replay.batch.dive_paths import usable_paths
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.calibration.dives import CalibratedDives, answer_of, calibrate_dives
from insdvl_replay.calibration.division import Division
from insdvl_replay.calibration.innovations import ReadDive, read_dive
from insdvl_replay.calibration.output import calibration_figures, calibration_toml
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import SCHEMA_LINE
from insdvl_replay.core.errors import Note
from insdvl_replay.core.runtime import track_progress
from insdvl_replay.document.parts import Figure


@dataclass(frozen=True)
class Asked:
    """What is estimated, and how."""

    groups: Sequence[str]  # of parameters
    hold_out: Sequence[str] = ()  # shares, or names of dives
    reference: bool = False  # compare with the references of the dives, and calibrate these, too
    one_delay: bool = False  # for all dives
    mounting_unknown: bool = False  # try 24 mountings first


@dataclass(frozen=True)
class CalibratedLogs:
    """A calibration of dives that were read from their logs."""

    dives: CalibratedDives

    @property
    def is_found(self) -> bool:
        """Whether anything was estimated."""
        found = self.dives.found
        return bool(found.estimated) or found.proposes_noise

    @property
    def notes(self) -> list[tuple[str, Note]]:
        """The notes on the dives that were fitted, each with the name of its dive."""
        notes = []
        for read, used in zip(self.dives.kept, self.dives.innovations, strict=True):
            for note in (*read.dive.notes, *used.prepared.notes):
                notes.append((read.dive.name, note))
        return notes

    def figures(self) -> tuple[Figure, ...]:
        """Draw what the calibration changes."""
        return calibration_figures(self.dives.found, self.dives.innovations)

    def settings(self, *, even_if_worse: bool = False) -> str:
        """Return the proposed settings as TOML, without what is worse on held-out dives; empty if nothing was found."""
        if not self.is_found:
            return ""
        found = self.dives.found
        if not even_if_worse:
            found = answer_of(found).applied(found)
        starts_ns = [dive.prepared.alignment.start_ns for dive in self.dives.innovations]
        return SCHEMA_LINE + calibration_toml(found, starts_ns)


def calibrate_logs(
    dives: Sequence[Sequence[FoundDive]],  # the files of each
    config: Config,
    asked: Asked,
    failed: Callable[[Exception], None],  # is told of each dive that cannot be used
    *,
    allow_damaged: bool = False,
) -> CalibratedLogs | None:
    """Calibrate the dives that can be read; None if there is no such dive.

    Raises
    ------
    ConfigError
        What is held out is not known, or leaves no dive to fit.
    """
    read = _read(dives, config, failed, allow_damaged=allow_damaged)
    if not read:
        return None
    found = calibrate_dives(
        Division.asked(read, asked.hold_out),
        config,
        asked.groups,
        reference=asked.reference,
        one_delay=asked.one_delay,
        mounting_unknown=asked.mounting_unknown,
    )
    return CalibratedLogs(found)


def _read(
    dives: Sequence[Sequence[FoundDive]],
    config: Config,
    failed: Callable[[Exception], None],
    *,
    allow_damaged: bool,
) -> list[ReadDive]:
    """Read dives that have enough pings; one that cannot be used does not stop the others."""
    usable = []
    for files in track_progress("reading", dives):
        try:
            read = read_dive(usable_paths(files), config, allow_damaged=allow_damaged)
            read.innovations()
        except Exception as error:
            failed(error)
        else:
            usable.append(read)
    return usable
