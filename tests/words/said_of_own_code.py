"""Mistakes in measurements of a user's own, which lie beside the tests of replays."""

import sys
from pathlib import Path

from as_text import Cases, refusal

from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.sim.dive import simulate_dive

REPLAYS = Path(__file__).parents[1] / "replay"
REFUSED = (
    "nowhere_at_all:Speed",
    "own_sensors:Nothing",
    "own_sensors:NOT_A_CLASS",
    "own_sensors:Three",
    "own_sensors:Six",
    "own_sensors:Leaving",
    "own_sensors:Late",
    "own_sensors:Sped",
    ":Speed",
    "own_sensors:NoPrediction",
    "own_sensors:NoReadings",
    "own_sensors:Bound",
    "own_sensors:OtherTopic",
    "own_sensors:Unreturned",
    "own_sensors:NoNumbers",
    "own_sensors:Misspelt",
    "own_sensors:FirstOfSpeed",
    "own_sensors:BuiltIn",
)


def said_of_own_code(_: Path) -> Cases:
    """Return what is said of each class as a dive is prepared."""
    dive = simulate_dive("lawnmower", seed=4, duration_s=20.0, grade="mems", imu_rate_hz=50.0)

    def prepared(*words: str) -> Prepared:
        filters = {
            "baseline": Filter(aiding=("velocity",)),
            "mine": Filter(aiding=("velocity", *words)),
        }
        return prepare_dive(dive, Config(filters=filters, evaluation=Evaluation(starts=1)))

    sys.path.insert(0, str(REPLAYS))
    try:
        for word in REFUSED:
            yield word, refusal(prepared, word)
        yield "two of one name", refusal(prepared, "own_sensors:Speed", "own_sensors:OtherSpeed")
    finally:
        sys.path.remove(str(REPLAYS))
