"""A program as a candidate: it is given a dive as MCAP and a start as JSON, and writes its solution as CSV.

The program is started without a command shell, with the user's rights, in the current folder.
"""

import contextlib
import io
import os
import signal
import subprocess
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from insdvl_replay import logs
from insdvl_replay.core.config import MOST_BYTES, Config, Evaluation
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import hint_for, read_regular, visible
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import moved_position, north_east_down_m
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.nav.user_candidate import Candidate, CandidateError, CandidateStart, Solution, misalignment_cov
from insdvl_replay.preparation.candidates import MOST_COVARIANCES

TIMEOUT_S: Final = 600.0
LONGEST_OUTPUT: Final = 1 << 16  # bytes of stdout, and of stderr, that are kept of one run
LONGEST_LINE: Final = 200
VELOCITY: Final = ("velocity_n_mps", "velocity_e_mps", "velocity_d_mps")
ATTITUDE: Final = ("roll_deg", "pitch_deg", "heading_deg")
POSITION: Final = ("latitude_deg", "longitude_deg", "height_m")
INNOVATION: Final = ("innovation_x_mps", "innovation_y_mps", "innovation_z_mps")
_GROUPS: Final = (POSITION, VELOCITY, ATTITUDE, INNOVATION)
_COLUMNS: Final = ("time_ns", *(f"{name}{end}" for group in _GROUPS for name in group for end in ("", "_sd")))
_TOPICS: Final = {"/pressure": "depth", "/ahrs": "heading", "/gnss": "position"}  # as `logs.write_dive` writes them


@dataclass
class Program:
    """A program in the settings, with what its runs have printed."""

    command: tuple[str, ...]
    timeout_s: float
    folder: Path  # for its files
    printed: dict[str, str] = field(default_factory=dict)  # by run
    _running: set["subprocess.Popen[bytes]"] = field(default_factory=set)
    _is_stopped: threading.Event = field(default_factory=threading.Event)

    def run(self, run: str, dive_file: Path, start: CandidateStart) -> Solution:
        """Run it over a dive, from a start; the name of the run names its folder."""
        folder = self.folder / run
        folder.mkdir()
        start_file, solution_file = folder / "start.json", folder / "solution.csv"
        start_file.write_text(start.to_json(), "utf-8")
        places = {"{dive}": dive_file, "{start}": start_file, "{solution}": solution_file}
        words = list(self.command)
        for place, path in places.items():
            words = [word.replace(place, str(path)) for word in words]
        outputs = folder / "stdout", folder / "stderr"
        try:
            self._run(words, *outputs)
            return read_solution(solution_file)
        except CandidateError as error:
            raise CandidateError(f"{error}{_last_line(outputs[1])}") from error
        finally:
            texts = [f"--- {run}: {path.name}\n{text}" for path in outputs if (text := _tail(path))]
            self.printed[run] = "".join(texts)
            with contextlib.suppress(OSError):
                solution_file.unlink()

    def _run(self, words: list[str], stdout: Path, stderr: Path) -> None:
        with stdout.open("wb") as out, stderr.open("wb") as err:
            try:
                process = subprocess.Popen(
                    words, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
                )
            except (OSError, ValueError) as error:
                why = error.strerror if isinstance(error, OSError) else error
                raise CandidateError(f"cannot be started: {visible(words[0])}: {why}") from error
            self._running.add(process)
            if self._is_stopped.is_set():
                self.stop()
            try:
                code = process.wait(self.timeout_s)
            except subprocess.TimeoutExpired as error:
                _kill(process)
                raise CandidateError(f"did not end within {self.timeout_s:g} s") from error
            finally:
                self._running.discard(process)
        if code < 0:
            name = next((known.name for known in signal.Signals if known == -code), str(-code))
            raise CandidateError(f"was ended by the signal {name}")
        if code:
            raise CandidateError(f"ended with exit code {code}")

    def stop(self) -> None:
        """End all runs, with what they have started."""
        self._is_stopped.set()
        for process in list(self._running):
            _kill(process)


def _kill(process: "subprocess.Popen[bytes]") -> None:
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _tail(path: Path) -> str:
    """Return the end of what was printed, with a final line break; nothing where the program removed it."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - LONGEST_OUTPUT))
        text = file.read().decode("utf-8", "replace")
    return text if text.endswith("\n") or not text else f"{text}\n"


def _last_line(path: Path) -> str:
    lines = [line.strip() for line in _tail(path).splitlines() if line.strip()]
    return f": {visible(lines[-1])[:LONGEST_LINE]}" if lines else ""


# --- The solution as CSV.


def read_solution(path: Path) -> Solution:
    """Read a solution; columns may be missing."""
    import pandas as pd  # heavy

    try:
        data = read_regular(path, MOST_BYTES)
    except OSError as error:
        text = "wrote no solution" if isinstance(error, FileNotFoundError) else f"wrote a solution: {error.strerror}"
        raise CandidateError(text) from error
    if not data.strip():
        raise CandidateError("wrote an empty solution")
    try:
        table = pd.read_csv(io.BytesIO(data), dtype=dict.fromkeys(_COLUMNS[1:], "f8"), index_col=False)
    except (ValueError, OverflowError) as error:  # pandas' own errors are ValueErrors
        why = visible(str(error))[:LONGEST_LINE]
        raise CandidateError(f"wrote a solution that is not CSV of numbers: {why}") from error
    if table.empty:
        raise CandidateError("wrote a solution without rows")
    unknown = next((name for name in map(str, table.columns) if name not in _COLUMNS), None)
    if unknown is not None:
        hint = hint_for(unknown, _COLUMNS, most=1)
        raise CandidateError(
            f"wrote a solution with the column '{visible(unknown)[:LONGEST_LINE]}', which is not known ({hint})"
        )
    if "time_ns" not in table:
        raise CandidateError("wrote a solution without the column time_ns")
    if not data.endswith(b"\n") and table.iloc[-1].isna().any():
        raise CandidateError(f"wrote a solution that is cut off in line {len(table) + 1}")

    def group(names: tuple[str, ...], end: str = "") -> Floats | None:
        """Return the columns of a quantity; None where they are missing."""
        wanted = [f"{name}{end}" for name in names]
        lacking = [name for name in wanted if name not in table]
        if names == POSITION and lacking == wanted[2:]:
            table[wanted[2]], lacking = np.nan, []
        if lacking and len(lacking) < len(wanted):
            given = next(name for name in wanted if name in table)
            raise CandidateError(f"wrote a solution with {given}, but without {' and '.join(lacking)}")
        return None if lacking else table[wanted].to_numpy(np.float64)

    position, rpy, innovation = group(POSITION), group(ATTITUDE), group(INNOVATION)
    innovation_sd = group(INNOVATION, "_sd")
    if position is not None:
        position = position * [DEG, DEG, 1.0]
    # Covariances at evenly chosen rows. The parts that are not given stay NaN.
    chosen = slice(None, None, 1 + len(table) // MOST_COVARIANCES)
    sds = [None if sd is None else sd[chosen] for sd in (group(VELOCITY, "_sd"), group(ATTITUDE, "_sd"))]
    position_sd = group(POSITION, "_sd")
    if position_sd is not None:
        here = np.zeros(3) if position is None else np.nan_to_num(position[chosen])
        sds.append(np.abs(north_east_down_m(here + position_sd[chosen] * [DEG, DEG, 1.0], here)))
    given = [block for block, sd in enumerate((*sds, None)[:3]) if sd is not None]
    cov = np.full((len(table.index[chosen]), 9, 9), np.nan)
    known = np.array([3 * block + axis for block in given for axis in range(3)], np.int64)
    cov[:, known[:, None], known] = 0.0
    for block in given:
        sd, rows = np.asarray(sds[block]), slice(3 * block, 3 * block + 3)
        if block == 1:
            cov[:, rows, rows] = misalignment_cov(sd * DEG, np.zeros(len(sd)) if rpy is None else rpy[chosen, 2] * DEG)
        else:
            cov[:, rows, rows] = sd[:, :, None] ** 2 * np.eye(3)
    try:
        time_ns = table["time_ns"].to_numpy(np.int64)
    except (TypeError, ValueError, OverflowError) as error:
        raise CandidateError("wrote a solution with times that are not whole nanoseconds") from error
    if table["time_ns"].dtype.kind != "i":
        raise CandidateError("wrote a solution with times that are not whole nanoseconds")
    return Solution(
        time_ns,
        position,
        group(VELOCITY),
        None if rpy is None else mat_from_rpy(rpy * DEG),
        cov if given else None,
        time_ns[chosen] if given else None,
        innovation,
        None if innovation_sd is None else innovation_sd[:, :, None] ** 2 * np.eye(3),
    )


def write_solution(path: Path, solution: Solution) -> None:
    """Write a solution as `read_solution` reads it: of covariances the diagonals, if there is one for each row."""
    import pandas as pd

    columns: dict[str, Any] = {"time_ns": solution.time_ns}
    position, mat_nb, innovation_cov = solution.position, solution.mat_nb, solution.innovation_cov
    rpy = None if mat_nb is None else rpy_from_mat(mat_nb)
    groups: tuple[tuple[tuple[str, ...], Floats | None], ...] = (
        (POSITION, None if position is None else position / [DEG, DEG, 1.0]),
        (VELOCITY, solution.velocity_n),
        (ATTITUDE, None if rpy is None else rpy / DEG),
        (INNOVATION, solution.innovation_b),
    )
    sds = dict[tuple[str, ...], Floats]()
    if innovation_cov is not None:
        sds[INNOVATION] = np.sqrt(np.diagonal(innovation_cov, axis1=1, axis2=2))
    if solution.cov is not None and solution.cov_ns is None:
        sd = np.sqrt(np.diagonal(solution.cov, axis1=1, axis2=2))
        sds[VELOCITY] = sd[:, :3]
        if rpy is not None:
            level_nb = mat_from_rpy(rpy * [0.0, 0.0, 1.0])
            level_cov = np.swapaxes(level_nb, 1, 2) @ solution.cov[:, 3:6, 3:6] @ level_nb
            sds[ATTITUDE] = np.sqrt(np.diagonal(level_cov, axis1=1, axis2=2)) / DEG
        if position is not None and np.isfinite(sd[:, 6:]).any():
            sds[POSITION] = np.abs(moved_position(position, sd[:, 6:]) - position) / [DEG, DEG, 1.0]
    for names, values in groups:
        if values is not None:
            columns |= dict(zip(names, values.T, strict=True))
        if names in sds:
            columns |= {f"{name}_sd": column for name, column in zip(names, sds[names].T, strict=True)}
    pd.DataFrame(columns).to_csv(path, index=False)


def run_as_program(kind: type[Candidate], dive_file: Path, start_file: Path, solution_file: Path) -> None:
    """Run a class over the files that a program is given."""
    start = CandidateStart.from_json(start_file.read_text("utf-8"))
    dive = logs.read_dive(dive_file, Config())
    if sensors := tuple(_TOPICS[channel.topic] for channel in dive.channels if channel.topic in _TOPICS):
        dive = logs.read_dive(dive_file, Config(evaluation=Evaluation(held_out=sensors)))
    write_solution(solution_file, kind().run(dive, start))
