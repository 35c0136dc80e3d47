"""The user's filters in processes of their own: a program, which gets a dive and a start as files, or a Python class.

They have the user's rights, and run in the current folder. A program is started without a command shell. A class is
imported by a new interpreter, which runs it as often as it is asked to: what it prints, or an end of its process, is
its own matter.
"""

import contextlib
import math
import os
import pickle
import queue
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from insdvl_replay.core.config import Filter
from insdvl_replay.core.errors import visible
from insdvl_replay.logs.readings_csv import READING_FILES
from insdvl_replay.nav.user_candidate import CandidateError, CandidateStart, Solution
from insdvl_replay.preparation.solution_files import LONGEST_LINE, read_solution
from insdvl_replay.preparation.user_process import HEADER, MARK, children_s, run_class

TIMEOUT_S: Final = 600.0
LONGEST_OUTPUT: Final = 1 << 16  # bytes of stdout, and of stderr, that are kept of one run
LONGEST_PART: Final = 1 << 20  # bytes of an answer that are read at once
# by input, of a dive's name
DIVE_FILES: Final = {
    "class": "{}.pickle",
    "clean": "{}.mcap",
    "log": "{}_log.mcap",
}
Process = subprocess.Popen[bytes]


class UserProcesses:
    """The processes of one filter of the user's, and what they have printed."""

    def __init__(self, settings: Filter, folder: Path) -> None:
        self.settings = settings
        self.folder = folder  # for its files
        self.input = "class"
        if settings.program is not None:
            self.input = settings.input or "clean"
        self.timeout_s = settings.timeout_s or TIMEOUT_S  # of one run
        self.too_late = f"did not end within {self.timeout_s:g} s"
        self.cpu_s = math.nan  # processor seconds of the first run
        self._running = set[Process]()
        self._is_stopped = threading.Event()
        # Of a class, ready for another run.
        self._idle: queue.SimpleQueue[Process] = queue.SimpleQueue()
        folder.mkdir()

    def file(self, dive: str) -> Path:
        """Return the file of a dive, by the name of the dive."""
        return self.folder / DIVE_FILES[self.input].format(dive)

    def reading_files(self, dive: str) -> dict[str, Path]:
        """Return the CSV files of a dive that its arguments ask for, by their words without braces."""
        files = {}
        for word in READING_FILES:
            if self._asks_for(word):
                files[word] = self.folder / f"{dive}_{word.removesuffix('_csv')}.csv"
        return files

    @property
    def reads_dive(self) -> bool:
        """Whether it reads the file of a dive, and not only CSV files."""
        return self.input == "class" or self._asks_for("dive")

    def _asks_for(self, word: str) -> bool:
        """Return whether an argument of the program has a word in braces."""
        return any(f"{{{word}}}" in argument for argument in self.settings.program or ())

    def run(
        self,
        run: str,
        dive: str,
        start: CandidateStart,
        *,
        new_process: bool = False,
    ) -> Solution:
        """Run the filter over a dive, which is named, from a start; the name of the run names its files.

        A run in a ``new_process`` is in one that no other run of a class was in.
        """
        if self.settings.candidate is not None:
            return self._run_class(
                self.settings.candidate, self.file(dive), start, new_process=new_process
            )
        folder = self.folder / run
        folder.mkdir()
        start_file = folder / "start.json"
        solution_file = folder / "solution"
        start_file.write_bytes(start.to_json())
        files = {
            "dive": self.file(dive),
            "start": start_file,
            "solution": solution_file,
            **self.reading_files(dive),
        }
        words = [_with_files(word, files) for word in self.settings.program or ()]
        try:
            begun_s = children_s()
            process = self._started(words, f"{run}: ")
            try:
                code = process.wait(self.timeout_s)
                self._keep_cpu_s(children_s() - begun_s)
            except subprocess.TimeoutExpired as error:
                raise CandidateError(self.too_late) from error
            finally:
                self._end(process)
            if code:
                raise CandidateError(_ended(code))
            return read_solution(solution_file, start)
        except CandidateError as error:
            said = _last_line(self.folder / f"{run}: stderr")
            if said:
                raise CandidateError(f"{error}: {visible(said)[:LONGEST_LINE]}") from error
            raise
        finally:
            with contextlib.suppress(OSError):
                solution_file.unlink()

    def _keep_cpu_s(self, cpu_s: float) -> None:
        """Keep the processor seconds of the first run, beside which there is no other."""
        if math.isnan(self.cpu_s):
            self.cpu_s = cpu_s

    def _run_class(
        self,
        word: str,
        dive_file: Path,
        start: CandidateStart,
        *,
        new_process: bool,
    ) -> Solution:
        """Give a run to an idle process of the class, or to a new one."""
        try:
            if new_process:
                raise queue.Empty
            process = self._idle.get_nowait()
        except queue.Empty:
            path = os.pathsep.join(entry or "." for entry in sys.path)
            command = [
                sys.executable,
                "-P",
                "-u",
                "-c",
                f"from {run_class.__module__} import run_class; run_class()",
                word,
            ]
            process = self._started(
                command, "", subprocess.PIPE, os.environ | {"PYTHONPATH": path}
            )
        try:
            answer, cpu_s = self._answer(process, (dive_file, start))
        except CandidateError:
            self._end(process)
            raise
        self._idle.put(process)
        self._keep_cpu_s(cpu_s)
        if isinstance(answer, Exception):
            raise answer
        solution: Solution = answer
        return solution

    def _answer(self, process: Process, question: object) -> Any:
        """Return what the process of a class answers; what it has started may hold the pipe open."""
        assert process.stdin is not None
        assert process.stdout is not None
        until_s = time.monotonic() + self.timeout_s
        answer = bytearray()
        size = HEADER.size
        ready = select.poll()
        ready.register(process.stdout, select.POLLIN)
        with contextlib.suppress(BrokenPipeError):  # its end is read below
            process.stdin.write(pickle.dumps(question))
            process.stdin.flush()
        try:
            while len(answer) < size:
                left_s = until_s - time.monotonic()
                if left_s <= 0.0 or self._is_stopped.is_set():
                    raise CandidateError(self.too_late)
                if ready.poll(1000.0 * min(left_s, 1.0)):
                    part = os.read(process.stdout.fileno(), LONGEST_PART)
                    if not part:
                        raise CandidateError(_ended(process.wait(left_s)))
                    answer += part
                elif process.poll() is not None:
                    raise CandidateError(_ended(process.returncode))
                if len(answer) >= HEADER.size:
                    mark, length = HEADER.unpack_from(answer)
                    size = HEADER.size + length
                    if mark != MARK:
                        raise CandidateError("wrote into the pipe of its answer")
            return pickle.loads(memoryview(answer)[HEADER.size :])
        except subprocess.TimeoutExpired as error:
            raise CandidateError(self.too_late) from error

    def _started(
        self,
        words: list[str],
        name: str,
        pipe: int | None = None,
        env: Mapping[str, str] | None = None,
    ) -> Process:
        """Start a process in a group of its own; what it prints goes to files in the folder, or stdout to a pipe."""
        with (
            (self.folder / f"{name}stdout").open("ab") as out,
            (self.folder / f"{name}stderr").open("ab") as err,
        ):
            stdin = pipe or subprocess.DEVNULL
            stdout = pipe or out
            try:
                process = subprocess.Popen(
                    words,
                    stdin=stdin,
                    stdout=stdout,
                    stderr=err,
                    env=env,
                    start_new_session=True,
                )
            except OSError as error:
                raise CandidateError(
                    f"cannot be started: {visible(words[0])}: {error.strerror}"
                ) from error
            except ValueError as error:
                raise CandidateError(f"cannot be started: {visible(words[0])}: {error}") from error
        self._running.add(process)
        if self._is_stopped.is_set():
            self.stop()
        return process

    def _end(self, process: Process) -> None:
        """End a process, and what it has started and left behind."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for stream in filter(None, (process.stdin, process.stdout)):
            with contextlib.suppress(OSError):
                stream.close()
        self._running.discard(process)

    def stop(self) -> None:
        """End all runs, with what they have started."""
        self._is_stopped.set()
        for process in list(self._running):
            self._end(process)

    @property
    def printed(self) -> str:
        """Everything that its runs have printed."""
        texts = []
        for path in sorted(self.folder.glob("*std*")):
            text = _tail(path)
            if text and path.name != "stderr":
                texts.append(f"--- {path.name}\n")
            texts.append(text)
        return "".join(texts)


def _with_files(argument: str, files: Mapping[str, Path]) -> str:
    """Return an argument of a program with the paths of files in place of words in braces."""
    for word, file in files.items():
        argument = argument.replace(f"{{{word}}}", str(file))
    return argument


def _ended(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = str(-code)
    return f"was ended by the signal {name}"


def _last_line(path: Path) -> str:
    """Return the last line of what was printed that is not blank; empty if there is none."""
    lines = [line.strip() for line in _tail(path).splitlines() if line.strip()]
    if lines:
        return lines[-1]
    return ""


def _tail(path: Path) -> str:
    """Return the end of what was printed, with a final line break; nothing where the program removed it."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - LONGEST_OUTPUT))
        text = file.read().decode("utf-8", "replace")
    if text.endswith("\n") or not text:
        return text
    return f"{text}\n"
