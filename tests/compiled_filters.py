"""Compile every filter that the tests of a commit run, one after the other in this process.

Each number of states is a filter of its own to the compiler, with or without a measurement of a user's. What they
share is compiled once in a process. Two workers that meet a filter at the same time would both compile it. Those that
only tests of the night run are compiled when they meet them.
"""

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.core.config_file import load_config
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive

BUILT_IN = ("velocity",)
WITH_A_USERS = ("velocity", "own_sensors:Speed")
FILTERS = {
    "twelve": Filter(aiding=BUILT_IN),
    "fifteen": Filter(aiding=BUILT_IN, states=("position",)),
    "twelve_and_a_users": Filter(aiding=WITH_A_USERS),
    "fifteen_and_a_users": Filter(aiding=WITH_A_USERS, states=("position",)),
}
DURATION_S = 10.0


def main() -> int:
    """Compile what users compile, and then the others."""
    code = run_command_line(["compile"])
    dive = simulate_dive("straight", seed=1, duration_s=DURATION_S, imu_rate_hz=50.0)
    defaults = load_config("mems")
    settings = Config(
        noise=defaults.noise,
        initial=defaults.initial,
        filters=FILTERS,
        evaluation=Evaluation(starts=1),
    )
    replay_dive(dive, settings)
    return code


if __name__ == "__main__":
    raise SystemExit(main())
