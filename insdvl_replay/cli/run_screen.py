"""What `run` prints of its dives: the results on stdout, one by one or at the end, and on stderr what to know."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from insdvl_replay.batch.overviews import renew_overviews, write_overviews
from insdvl_replay.cli.messages import (
    log_failure,
    log_findings,
    log_notes,
    log_to_stderr,
    write_stdout,
)
from insdvl_replay.cli.screen import written
from insdvl_replay.core.errors import LogError, Note, visible
from insdvl_replay.core.report import Report
from insdvl_replay.document.parts import Heading, Part
from insdvl_replay.results.folder import PAGE, VEHICLE_FILE
from insdvl_replay.results.stored_results import dives_of_run, earlier_results
from insdvl_replay.show.answers import Failure
from insdvl_replay.show.dive import TOGETHER, dive_document, replay_result, tables_named
from insdvl_replay.show.dives import INDEX, named_result, overview_parts
from insdvl_replay.show.screens import dive_screen, dives_screen, quiet_lines

WHOLE = ("json", "csv", "html")
"""Formats of which one document holds all dives."""


@dataclass(frozen=True)
class Wanted:
    """What shall be printed."""

    format: str
    tables: Sequence[str]  # only these; all without any
    verbose: int
    quiet: bool
    strict: bool  # a warning is an error

    @property
    def is_brief(self) -> bool:
        """Whether there is only a line for each filter."""
        return self.quiet and self.format == "table"

    @property
    def is_screen(self) -> bool:
        """Whether stdout shows the screen for people."""
        return self.format == "table" and not (self.tables or self.verbose or self.quiet)

    @property
    def talks(self) -> bool:
        """Whether stderr names each result and warning: beside the screen only if it is not the same terminal."""
        return not (self.quiet or (self.is_screen and sys.stderr.isatty()))

    @property
    def is_at_the_end(self) -> bool:
        """Whether what is asked for needs all dives, or cannot be printed dive by dive."""
        is_of_all = bool(self.tables) and set(self.tables) <= set(TOGETHER)
        return self.format in WHOLE or is_of_all


@dataclass
class RunScreen:
    """The dives of a run as they are done, and what is printed of them."""

    targets: Sequence[Path]  # the folders of all dives, in their order
    output: Path
    wanted: Wanted
    is_shard: bool = False  # nothing is said of all dives, which other shards have, too
    _outcomes: dict[str, Report | Failure] = field(default_factory=dict)  # by dive
    _codes: dict[str, int] = field(default_factory=dict)  # exit codes by dive
    _unchanged: int = 0
    _is_explained: bool = False
    _said: set[tuple[Note, ...]] = field(default_factory=set)  # of the vehicle, or of several

    @property
    def _is_alone(self) -> bool:
        return len(self.targets) == 1 and not self.is_shard

    @property
    def _reports(self) -> list[Report | Failure]:
        """What became of the dives, in their order and not in that in which they were done."""
        names = [target.name for target in self.targets]
        return [self._outcomes[name] for name in names if name in self._outcomes]

    @property
    def _prints_each(self) -> bool:
        """Whether each dive is printed as it is done."""
        wanted = self.wanted
        if wanted.is_brief:
            return False
        if self._is_alone and not wanted.tables:
            return True
        return not (wanted.is_at_the_end or wanted.is_screen)

    def add(
        self,
        target: Path,
        report: Report | Exception,
        *,
        unchanged: bool,
    ) -> None:
        """Print what is to be known of a dive that is done."""
        name = target.name
        if isinstance(report, Exception):
            self._outcomes[name] = Failure(name, str(report))
            self._codes[name] = log_failure(report, self.wanted.verbose)
            return
        self._outcomes[name] = report
        if unchanged:
            self._unchanged += 1
        self._tell_findings(report, target)
        self._tell_notes(report, name)
        self._tell_time(report.tool.cpu_s)
        self._tell_place(target, unchanged=unchanged)
        if self._prints_each:
            write_stdout(self._shown(report, target))
        self._codes[name] = self._strict_code(name, report)

    def _tell_findings(self, report: Report, target: Path) -> None:
        """Say which settings were found, once for all dives of a vehicle."""
        findings = [note for note in report.notes if note.is_own_finding]
        if not findings:
            findings = [note for note in report.notes if note.is_finding]
        said = tuple(findings)
        if not self.wanted.quiet and said not in self._said:
            self._said.add(said)
            log_findings(said, target / VEHICLE_FILE)

    def _tell_notes(self, report: Report, name: str) -> None:
        """Report the warnings of a dive, and how to learn more of them."""
        if not self.wanted.talks and (self.wanted.quiet or not self._is_alone):
            return
        dive = name
        if self._is_alone:
            dive = ""
        notes = [note for note in report.notes if not note.is_finding]
        log_notes(notes, verbose=self.wanted.verbose > 0, dive=dive)
        if self.wanted.verbose and report.notes and not self._is_explained:
            log_to_stderr("`insdvl-replay explain CODE` tells more about a note")
            self._is_explained = True

    def _tell_time(self, cpu_s: Mapping[str, float]) -> None:
        """Report how many processor seconds one run of each filter over the dive took, if verbose."""
        if self.wanted.verbose and cpu_s:
            times = ", ".join(f"{name} {seconds:.3g} s" for name, seconds in cpu_s.items())
            log_to_stderr(f"processor time of one run over the dive: {times}")

    def _tell_place(self, target: Path, *, unchanged: bool) -> None:
        """Say where a result is, and whether it was there before."""
        is_reported = unchanged and self._is_alone and not self.wanted.quiet
        if not (self.wanted.talks or is_reported):
            return
        word = "wrote"
        if unchanged:
            word = "unchanged"
        log_to_stderr(f"{word} {target}")

    def _shown(self, report: Report, target: Path) -> str:
        """Return what is printed of one dive."""
        tables = self.wanted.tables
        parts: Sequence[Part]
        if tables:
            parts = tables_named(report, *tables)
        elif self.wanted.is_screen:
            parts = dive_screen(report, str(target / PAGE))
        else:
            parts = dive_document(report)
        return written(replay_result(report, parts, tables), self.wanted.format)

    def _strict_code(self, name: str, report: Report) -> int:
        """Return the exit code of a dive, which may have to be without warnings."""
        warnings = [note.code for note in report.notes if note.severity == "warning"]
        if not (self.wanted.strict and warnings):
            return 0
        found = f"{name}: --strict allows no warnings, found {', '.join(warnings)}"
        hint = "the result was written; leave --strict out to accept it"
        return log_failure(LogError(found, hint), self.wanted.verbose)

    # --- Once all dives are done.

    def finish(self) -> int:
        """Write the overviews of several dives, print what is of all dives, and return the exit code."""
        wanted = self.wanted
        if wanted.is_brief:
            write_stdout("".join(f"{visible(line)}\n" for line in quiet_lines(self._reports)))
        elif wanted.tables:
            write_stdout(self._tables_of_all())
        if self._is_alone:
            self._finish_alone()
        else:
            self._finish_several()
        return max(self._codes.values())

    def finish_shard(self, sentence: str) -> int:
        """Print what a shard has done, and return the exit code."""
        write_stdout(f"{visible(sentence)}\n")
        self._tell_failures()
        return max(self._codes.values(), default=0)

    def _finish_alone(self) -> None:
        """Let no overview of an earlier run pass for one of this run."""
        for report in self._done():
            for path in renew_overviews(report, self.output, is_new=not self._unchanged):
                if self.wanted.talks:
                    log_to_stderr(f"wrote {path}")
            if dives_of_run(self.output) == {report.log.name}:
                self._tell_earlier_results()

    def _tell_earlier_results(self) -> None:
        """Say which results in the folder are not of this run, also those of dives that failed in it."""
        done = {report.log.name for report in self._done()}
        log_notes(earlier_results(self.output, done), verbose=False)

    def _finish_several(self) -> None:
        wanted = self.wanted
        for path in write_overviews(self._reports, self.output):
            if wanted.talks:
                log_to_stderr(f"wrote {path}")
        self._tell_earlier_results()
        if self._unchanged and not (wanted.quiet or wanted.talks):
            log_to_stderr(f"unchanged: {self._unchanged} of {len(self.targets)} dives")
        if not wanted.tables and (not wanted.quiet or wanted.format in WHOLE):
            write_stdout(self._last_screen())
        self._tell_failures()

    def _tables_of_all(self) -> str:
        """Return the named tables over all dives, after those of each dive if these are printed at the end, too."""
        tables = self.wanted.tables
        parts: list[Part] = []
        if self.wanted.is_at_the_end:
            for report in self._done():
                parts += [Heading(report.log.name), *tables_named(report, *tables)]
        elif set(tables).isdisjoint(TOGETHER):
            return ""
        return written(named_result(self._reports, tables, parts), self.wanted.format)

    def _last_screen(self) -> str:
        """Return what is printed of all dives together."""
        parts: Sequence[Part]
        if self.wanted.format == "table":
            parts = dives_screen(self._reports, str(self.output / INDEX))
        else:
            parts = overview_parts(self._reports)
        return written(replay_result(self._done(), parts), self.wanted.format)

    def _done(self) -> list[Report]:
        return [report for report in self._reports if isinstance(report, Report)]

    def _tell_failures(self) -> None:
        """Say on the last line which dives failed, and why the first did."""
        failed = [name for name, code in self._codes.items() if code]
        if not failed:
            return
        first = ""
        for report in self._reports:
            if isinstance(report, Failure):
                first = f"; the first: {report.reason}"
                break
        names = ", ".join(failed)
        log_to_stderr(f"error: {len(failed)} of {len(self._codes)} logs failed: {names}{first}")
