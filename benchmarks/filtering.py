"""How long a filter takes an epoch, against other filters on the same readings; and a Monte Carlo study by its stages.

`make bench` runs this, with the helpers of the tests on the path. All contenders are measured in turn, several
times; what counts are the ratios, since they hardly depend on the machine.
"""

import argparse
import shutil
import subprocess
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from instants import instants
from plain_filter import Inputs, baseline_inputs, run_plain_filter
from python_ins import Case, their_belief
from results import machine, table, write_part

from insdvl_replay.core.config import Dvl
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.levelling import with_more_states
from insdvl_replay.nav.user_candidate import CandidateStart
from insdvl_replay.studies import montecarlo
from insdvl_replay.studies.montecarlo import study_montecarlo

ROUNDS = 5
AGAIN = 40
"""Runs of the compiled filter in one measurement, of which the fastest counts: one takes a millisecond."""
GOALS = (
    "At most 0.25 us an epoch with twelve states, 1000 times python-ins, 10 times GTSAM; 100 runs of a lawnmower in "
    "15 s on two cores; at most 1.7 times C++ for the same processor."
)
HERE = Path(__file__).parent
IN_CPP = HERE / "timed_filter.cpp"
EXAMPLES = HERE.parent / "examples" / "candidates"
COMPILER = "c++"
CPP_OPTIONS = {
    "C++, -O3": ("-O3",),
    "C++, -O3 -march=native": ("-O3", "-march=native"),
}
VELOCITY_SD_MPS = 0.006
"""Of each axis: the filter in C++ has one noise for all."""
STATES = {
    "12": ((), ()),
    "15: and the position": (("position",), (1.0, 1.0, 1.0)),
    "17: and the DVL's scale and yaw": (
        ("position", "dvl_scale", "dvl_yaw"),
        (1.0, 1.0, 1.0, 5e-3, 2e-2),
    ),
}
"""Blocks of states beside the twelve, and their standard deviations at the start."""
STAGES = {"add_errors": "noise", "run_filter": "filters", "run_errors": "statistics"}

EQUAL = 0.005
"""Standard deviations that differ by more are not equal results."""

Contender = Callable[[], tuple[float, Floats | None]]
"""Gives seconds, and the standard deviations of the six biases at the end where it has any."""


def epochs_of(inputs: Inputs) -> int:
    """Count the intervals of the time line."""
    return len(instants(inputs.timeline).time_s) - 1


def with_insdvl_replay(inputs: Inputs) -> tuple[float, Floats]:
    """Run the compiled filter."""
    timeline, start, noise_density, velocity = inputs
    took_s = []
    for _ in range(AGAIN):
        start_s = time.thread_time()
        history = run_filter("baseline", timeline, start, noise_density, (velocity,), np.zeros(3))
        took_s.append(time.thread_time() - start_s)
    return min(took_s), history.sd[-1, 6:]


def with_numpy(inputs: Inputs) -> tuple[float, Floats]:
    """Run the same equations as matrices of numpy."""
    start_s = time.thread_time()
    prediction = run_plain_filter(inputs)
    return time.thread_time() - start_s, np.sqrt(np.diag(prediction.P))[6:]


def with_python_ins(case: Case, dive: Dive) -> tuple[float, Floats]:
    """Run python-ins, which has a state for the position, too."""
    velocities = case.velocities(dive)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        start_s = time.thread_time()
        prediction = their_belief(dive, velocities)
        return time.thread_time() - start_s, prediction.bias_sd


def gtsam_contenders(inputs: Inputs) -> dict[str, Contender]:
    """Let GTSAM integrate the readings, one call of Python for each, and smooth; nothing where it is not installed."""
    if find_spec("gtsam") is None:
        return {}
    from gtsam_smoother import smooth

    def integrated() -> tuple[float, None]:
        return smooth(inputs).integration_s, None

    def smoothed() -> tuple[float, Floats]:
        found = smooth(inputs)
        return found.whole_s, found.bias_sd

    return {"GTSAM, integration alone": integrated, "GTSAM, a smoother": smoothed}


def contenders() -> tuple[int, dict[str, Contender]]:
    """Give the number of epochs, and what is measured on them."""
    case = Case()
    dive = case.dive()
    inputs = baseline_inputs(dive, case.config())
    found: dict[str, Contender] = {
        "insdvl-replay": lambda: with_insdvl_replay(inputs),
        "the same equations in numpy": lambda: with_numpy(inputs),
        "python-ins": lambda: with_python_ins(case, dive),
    }
    return epochs_of(inputs), found | gtsam_contenders(inputs)


def filter_rows() -> list[str]:
    """Measure all contenders in turn, and make a row of each.

    Raises
    ------
    RuntimeError
        One has other results than ours: then it does something else, and its time says nothing.
    """
    epochs, measured = contenders()
    took_s = defaultdict(list)
    sd = {}
    for _ in range(ROUNDS):
        for name, contender in measured.items():
            seconds, sd[name] = contender()
            took_s[name].append(seconds)
    ours_s = median(took_s["insdvl-replay"])
    ours_sd = sd["insdvl-replay"]
    rows = []
    for name, each_s in took_s.items():
        seconds = median(each_s)
        off = "" if sd[name] is None else _off(name, sd[name], ours_sd)
        rows.append(
            f"| {name} | {1e6 * seconds / epochs:.2f} | {seconds / ours_s:.0f} x | {off} |"
        )
    return rows


def _off(name: str, theirs_sd: Floats, ours_sd: Floats) -> str:
    off = float(np.abs(theirs_sd / ours_sd - 1.0).max())
    if off > EQUAL:
        raise RuntimeError(f"the standard deviations of {name} are off by {100.0 * off:.2g} %")
    return f"{100.0 * off:.2g} %"


def cpp_rows() -> list[str]:
    """Measure the example in C++ and the compiled filter in turn, on the same readings; no rows without a compiler.

    Raises
    ------
    RuntimeError
        The filter in C++ has other standard deviations.
    """
    if shutil.which(COMPILER) is None:
        return []
    case = Case()
    noise = Dvl(velocity_sd_mps=VELOCITY_SD_MPS)
    inputs = baseline_inputs(case.dive(), case.config(dvl=noise))
    with TemporaryDirectory() as folder:
        commands = _cpp_commands(inputs, Path(folder))
        took_s = defaultdict(list)
        sd = {}
        for _ in range(ROUNDS):
            seconds, ours_sd = with_insdvl_replay(inputs)
            took_s["insdvl-replay"].append(seconds)
            for name, command in commands.items():
                seconds, sd[name] = _with_cpp(command)
                took_s[name].append(seconds)
    epochs = epochs_of(inputs)
    ours_s = median(took_s["insdvl-replay"])
    rows = []
    for name, each_s in took_s.items():
        seconds = median(each_s)
        off = _off(name, sd[name], ours_sd) if name in sd else ""
        rows.append(
            f"| {name} | {1e6 * seconds / epochs:.2f} | {ours_s / seconds:.2f} x | {off} |"
        )
    return rows


def _cpp_commands(inputs: Inputs, folder: Path) -> dict[str, list[str]]:
    """Compile the filter in C++ with each set of options, and return how it is run on the readings."""
    readings = folder / "readings.bin"
    _readings_for_cpp(inputs).tofile(readings)
    start = folder / "start.json"
    fields = {name: getattr(inputs.start, name) for name in ("position", "velocity_n", "mat_nb")}
    start.write_bytes(CandidateStart(**fields, cov=inputs.start.cov).to_json())
    accel_white, gyro_white = np.sqrt(inputs.noise_density[[0, 3]]).tolist()
    noise = [f"{value:.17g}" for value in (accel_white, gyro_white, VELOCITY_SD_MPS)]
    commands = {}
    for name, options in CPP_OPTIONS.items():
        program = folder / "_".join(["filter", *options])
        subprocess.run(
            [COMPILER, "-std=c++17", *options, f"-I{EXAMPLES}", "-o", str(program), str(IN_CPP)],
            check=True,
        )
        commands[name] = [str(program), str(readings), str(start), str(AGAIN), *noise]
    return commands


def _readings_for_cpp(inputs: Inputs) -> Floats:
    """Return the readings at all epochs, and the velocities of the pings among them, (k, 8)."""
    at = instants(inputs.timeline)
    rows = []
    for k, time_s in enumerate(at.time_s - at.time_s[0]):
        rows.append([0.0, time_s, *at.angular_rate_b[k], *at.specific_force_b[k]])
        # A ping at the start is before the first epoch.
        if k and at.ping[k] >= 0:
            rows.append([1.0, time_s, *inputs.velocity.values[at.ping[k]], 0.0, 0.0, 0.0])
    return np.array(rows)


def _with_cpp(command: list[str]) -> tuple[float, Floats]:
    """Run the filter in C++; give its seconds, and the standard deviations of the biases at the end."""
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    seconds, *sd = map(float, done.stdout.split())
    return seconds, np.array(sd)


def state_rows() -> list[str]:
    """Measure the compiled filter with more states, in turn."""
    case = Case()
    inputs = baseline_inputs(case.dive(), case.config())
    epochs = epochs_of(inputs)
    least_s = dict.fromkeys(STATES, float("inf"))
    for _ in range(AGAIN):
        for name, (more, sd) in STATES.items():
            start = with_more_states(inputs.start, np.array(sd), max(0, len(sd) - 3))
            start_s = time.thread_time()
            run_filter(
                "baseline", inputs.timeline, start, inputs.noise_density, (inputs.velocity,), np.zeros(3),
                more_states=more,
            )  # fmt: skip
            least_s[name] = min(least_s[name], time.thread_time() - start_s)
    twelve_s = least_s["12"]
    return [
        f"| {name} | {1e6 * s / epochs:.2f} | {s / twelve_s:.1f} x |"
        for name, s in least_s.items()
    ]


@contextmanager
def stages_timed() -> Iterator[dict[str, float]]:
    """Add up the seconds of processor time that the stages of simulated runs take."""
    spent: dict[str, float] = defaultdict(float)
    originals = {name: getattr(montecarlo, name) for name in STAGES}

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **options: Any) -> Any:
            start_s = time.thread_time()
            result = function(*arguments, **options)
            spent[STAGES[name]] += time.thread_time() - start_s
            return result

        return run

    for name, function in originals.items():
        setattr(montecarlo, name, timed(name, function))
    try:
        yield spent
    finally:
        for name, function in originals.items():
            setattr(montecarlo, name, function)


def study_row(runs: int, jobs: int) -> str:
    """Time a study of a lawnmower, and then its stages."""
    took_s = []
    for _ in range(ROUNDS):
        start_s = time.perf_counter()
        study_montecarlo("lawnmower", load_config("levy-klein"), runs=runs, jobs=jobs)
        took_s.append(time.perf_counter() - start_s)
    with stages_timed() as spent:
        study_montecarlo("lawnmower", load_config("levy-klein"), runs=10, jobs=1)
    seconds = median(took_s)
    stages = " | ".join(f"{100.0 * spent[stage]:.0f}" for stage in STAGES.values())
    return f"| {runs} | {jobs} | {seconds:.1f} | {runs / seconds:.1f} | {stages} |"


def report(runs: int, jobs: int) -> str:
    """Measure everything and make a part of the page of it."""
    lines = [
        "# Filtering",
        "",
        "One filter aided by velocities, 60 s of a figure-eight with two turns at 100 Hz and 1 Hz: mechanisation and "
        "covariance at every reading, an update at every ping. Medians of five, measured in turn, in processor time of "
        "the calling thread; the last column is how far the standard deviation of any bias at the end is from ours. "
        "GTSAM integrates between pings (`PreintegratedCombinedMeasurements`), called from Python for each reading; it "
        "smooths over all (`CombinedImuFactor`, Levenberg-Marquardt), which gives what a filter gives at the end.",
        "",
        *table(("filter", "us an epoch", "against ours", "bias sd off by"), filter_rows()),
        "",
        "The filter of `examples/candidates/error_state_filter.cpp` on the same readings, measured in turn: its twelve "
        "states have simpler transitions, and it has no gate, no coning and no history of its sigmas. Ours is that "
        "many times theirs.",
        "",
        *table(("filter", "us an epoch", "ours against it", "bias sd off by"), cpp_rows()),
        "",
        "The same with more states; the fastest of forty, measured in turn.",
        "",
        *table(("states", "us an epoch", "against twelve"), state_rows()),
        "",
        "A Monte Carlo study of the lawnmower, 25 min at 100 Hz, both filters; stages in ms of processor time a run.",
        "",
        *table(("runs", "jobs", "s", "runs a second", *STAGES.values()), [study_row(runs, jobs)]),
        "",
        f"{machine()}; shared cores: read the ratios. {GOALS}",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print and write the part of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    part = report(arguments.runs, arguments.jobs)
    sys.stdout.write(part)
    write_part(part)


if __name__ == "__main__":
    main()
