"""A user's class, in a process of its own: run as often as the parent asks to, or as a program over files.

A candidate is run several times in several processes, so this module loads no more than such a process needs.
"""

import contextlib
import os
import pickle
import resource
import struct
import sys
import threading
import time
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.nav.user_candidate import Candidate, CandidateError, CandidateStart, Solution
from insdvl_replay.nav.user_measurement import failure_text, load_class
from insdvl_replay.preparation.solution_check import checked_solution

# before each answer of a class: that it is one, and its length
MARK: Final = b"solution"
HEADER: Final = struct.Struct("<8sQ")
# as `logs.write_dive` writes them
_TOPICS: Final = {
    "/pressure": "depth",
    "/ahrs": "heading",
    "/gnss": "position",
}


def run_class() -> None:
    """Run the class that the command line names over each dive that comes on stdin, and answer on stdout."""
    asked = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what the class prints goes to a file
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    with contextlib.suppress(EOFError, KeyboardInterrupt):
        while True:
            dive_file, start = pickle.load(asked)
            answer: Solution | Exception
            begun_s = time.process_time() + children_s()
            try:
                answer = solution_of_class(sys.argv[1], dive_file, start)
            except (CandidateError, ConfigError) as error:
                answer = error
            content = pickle.dumps((answer, time.process_time() + children_s() - begun_s))
            answers.write(HEADER.pack(MARK, len(content)) + content)
            answers.flush()


def _end_with(parent: int) -> None:
    """End this process once its parent was killed."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def solution_of_class(word: str, dive_file: Path, start: CandidateStart) -> Solution:
    """Import a class, run it over a dive, from a start, and check what it returns."""
    try:
        kind = load_class(word, Candidate)
    except ValueError as error:
        hint = "PYTHONPATH must contain the folder of the module"
        raise ConfigError(f"{word} {error}", f"example: docs/own_filter.md; {hint}") from error
    dive = pickle.loads(dive_file.read_bytes())
    try:
        solution = kind().run(dive, start)
    except (Exception, SystemExit) as error:
        raise CandidateError(f"{word} fails{failure_text(error, kind)}") from error
    if not isinstance(solution, Solution):
        raise CandidateError(f"run of {word} returns {type(solution).__name__}, not Solution")
    return checked_solution(solution)


def run_as_program(candidate: type[Candidate]) -> None:
    """Run your filter as a program that settings name with ``{dive}``, ``{start}`` and ``{solution}``, in this order.

    Parameters
    ----------
    candidate : type
        Your class, derived from `Candidate`.

    Raises
    ------
    SystemExit
        The program was called without these three paths.
    """
    if len(sys.argv) != 4:
        raise SystemExit(f"usage: {sys.argv[0]} DIVE START SOLUTION")
    run_over_files(candidate, *map(Path, sys.argv[1:]))


def run_over_files(
    kind: type[Candidate],
    dive_file: Path,
    start_file: Path,
    solution_file: Path,
) -> None:
    """Run a class over the files that a program is given."""
    # Heavy, and the process of a class gets no log.
    from insdvl_replay.core.config import Config, Evaluation
    from insdvl_replay.logs import read_dive

    start = CandidateStart.from_json(start_file.read_bytes())
    dive = read_dive(dive_file, Config())
    topics = [channel.topic for channel in dive.channels if channel.topic in _TOPICS]
    if topics:
        sensors = tuple(_TOPICS[topic] for topic in topics)
        dive = read_dive(dive_file, Config(evaluation=Evaluation(held_out=sensors)))
    solution = checked_solution(kind().run(dive, start))
    given = {name: column for name, column in vars(solution).items() if column is not None}
    with solution_file.open("wb") as file:
        np.savez(file, **given)


def children_s() -> float:
    """Return the processor seconds of all processes that this one has waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
