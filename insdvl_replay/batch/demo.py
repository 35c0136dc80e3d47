"""The demonstration: six simulated dives, and three changes of their settings of which each has another answer.

It needs no files but those that it makes. The dives are long enough that an error of the settings acts on them.
"""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from insdvl_replay.batch.against import compare_sides, plan_against
from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.jobs import ReplayOptions
from insdvl_replay.batch.local_settings import with_local_settings
from insdvl_replay.batch.manifest import fetch_dives
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.batch.search import outcomes
from insdvl_replay.core.config_file import SCHEMA_LINE
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.settings_layers import LOCAL_SETTINGS, SettingsLayers
from insdvl_replay.logs import write_dive
from insdvl_replay.results.folder import result_file
from insdvl_replay.sim.dive import simulate_dive

if TYPE_CHECKING:
    from insdvl_replay.changes.comparison import Comparison

DURATION_S: Final = 400.0
LEVER_ARM_M: Final = (0.6, -0.2, 0.3)
DELAY_S: Final = 0.1
# Scenarios by the names of the dives; the number of a dive is its seed.
DIVES: Final = {
    "lawnmower_1": "lawnmower",
    "lawnmower_2": "lawnmower",
    "figure_eight_3": "figure-eight",
    "figure_eight_4": "figure-eight",
    "calibration_5": "calibration",
    "calibration_6": "calibration",
}
SETTINGS: Final = f"""{SCHEMA_LINE}\
# Settings of the simulated dives in this folder: how the DVL is built in, and the noise of the sensors.
# A run finds this file by its name. `insdvl-replay config` prints all keys.

[dvl]
lever_arm_m = [0.6, -0.2, 0.3]         # from the IMU to the DVL: forward, starboard, down
latency_s = 0.1
beam_sd_mps = 0.0042

[noise]
accel_white_mps_rts = 0.001
gyro_white_rad_rts = 2.9e-5
accel_bias_walk_mps2_rts = 2e-5
gyro_bias_walk_radps_rts = 8e-8

[filters.baseline]
aiding = ["velocity"]
gate_probability = 0.99999
"""


@dataclass(frozen=True)
class Question:
    """A change of settings, of which is asked whether it helped."""

    name: str  # of its folder and page
    text: str
    change: str  # ``section.key=value``
    before: tuple[str, ...] = ()  # settings in place of those of the file, before the change

    def command(self, folder: Path) -> list[str]:
        """Return the command that asks it of the dives in a folder."""
        words = ["insdvl-replay", "run", str(folder / "dives")]
        for setting in self.before:
            words += ["--set", setting]
        return [*words, "--against", self.change]


QUESTIONS: Final = (
    Question(
        "lever_arm",
        "the lever arm of the DVL was left out, and is put right",
        "dvl.lever_arm_m=[0.6,-0.2,0.3]",
        ("dvl.lever_arm_m=[0,0,0]",),
    ),
    Question("scale", "the scale of the DVL was right, and is wrong by 1 %", "dvl.scale=1.01"),
    Question(
        "gate",
        "the gate for outliers is moved, although the dives have none",
        "filters.baseline.gate_probability=0.9999",
    ),
)


@dataclass(frozen=True)
class DemoAnswer:
    """What the dives say of a change, and where its page is."""

    question: Question
    found: "Comparison"
    page: Path


def make_dives(folder: Path) -> None:
    """Write the dives and their settings below a folder, which may be that of an earlier demonstration.

    Raises
    ------
    ConfigError
        There is something else in the folder, or it cannot be written.
    """
    dives = folder / "dives"
    settings = dives / LOCAL_SETTINGS
    if folder.exists() and not settings.is_file() and (folder.is_file() or any(folder.iterdir())):
        hint = "choose another folder: insdvl-replay demo -o DIR"
        raise ConfigError(f"{folder}: holds something else than a demonstration", hint)
    dives.mkdir(parents=True, exist_ok=True)
    with result_file(settings, force=True) as file:
        file.write_text(SETTINGS, "utf-8")
    for seed, (name, scenario) in enumerate(DIVES.items(), 1):
        dive = simulate_dive(
            scenario,
            seed=seed,
            duration_s=DURATION_S,
            grade="tactical",
            lever_arm_m=LEVER_ARM_M,
            dvl_delay_s=DELAY_S,
        )
        with result_file(dives / f"{name}.mcap", force=True) as file:
            write_dive(file, dive)


def demo_answers(
    folder: Path, how: Replaying, begin: Callable[[Question], None]
) -> Iterator[DemoAnswer]:
    """Ask each question of the dives in a folder; it is told which one begins.

    Raises
    ------
    ConfigError
        Results cannot be written.
    """
    from insdvl_replay.changes.comparison import only_changed  # needs scipy
    from insdvl_replay.changes.comparison_document import comparison_document, comparison_result
    from insdvl_replay.document.render import render

    for question in QUESTIONS:
        begin(question)
        found = _compared(question, folder, how)
        document = comparison_document(only_changed(found))
        page = folder / f"{question.name}.html"
        with result_file(page, force=True) as file:
            file.write_text(render(comparison_result(found, document), "html"), "utf-8")
        yield DemoAnswer(question, found, page)


def _compared(question: Question, folder: Path, how: Replaying) -> "Comparison":
    """Replay the dives before and after a change, as ``run --against`` does, and compare both."""
    layers = SettingsLayers(overrides=question.before)
    dives = with_local_settings(find_dives([str(folder / "dives")]), layers)
    options = ReplayOptions(layers.load(dives[0].settings), histories=False)
    target = folder / question.name
    sides = plan_against(dives, target, options, layers, [question.change], fetch_dives, how)
    done = []
    with closing(outcomes(sides.jobs, how)) as replays:
        for outcome in replays:
            if isinstance(outcome.result, Exception):
                raise outcome.result
            done.append(outcome.result.log.name)
    found = compare_sides(sides, done)
    assert found is not None
    return found
