"""A measurement of a user's own aids a filter, compiled or as it is, and stands in the tables."""

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive


def replayed(word: str, duration_s: float = 200.0) -> Replay:
    dive = simulate_dive("lawnmower", seed=4, duration_s=duration_s, grade="mems", imu_rate_hz=50.0)
    mine = Filter(aiding=("velocity", word), gate_probability=0.999)
    mems, filters = load_config("mems"), {"baseline": Filter(aiding=("velocity",)), "mine": mine}
    config = Config(noise=mems.noise, initial=mems.initial, filters=filters, evaluation=Evaluation(starts=1))
    return replay_dive(dive, config)


def test_it_is_met_judged_and_shown() -> None:
    replay = replayed("own_sensors:Speed")
    met = next(one for one in replay.histories[1].innovations if one.measurement == "speed")
    assert met.used.mean() > 0.99
    assert 0.7 < met.nis.mean() < 1.3
    row = next(row for row in replay.tables.consistency if row.measurement == "speed")
    assert row.used == int(met.used.sum())
    assert not [note for note in replay.notes if note.code == "own_measurement_plain"]


def test_what_cannot_be_compiled_gives_the_same_and_says_so() -> None:
    compiled, plain = replayed("own_sensors:Speed", 20.0), replayed("own_sensors:PlainSpeed", 20.0)
    np.testing.assert_allclose(plain.histories[1].velocity_n, compiled.histories[1].velocity_n, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(plain.histories[1].sd, compiled.histories[1].sd, rtol=1e-9)
    (note,) = [note for note in plain.notes if note.code == "own_measurement_plain"]
    assert "PlainSpeed cannot be compiled" in note.text


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        ("nowhere_at_all:Speed", "cannot be imported: No module named 'nowhere_at_all'"),
        ("own_sensors:Nothing", "is not in own_sensors"),
        ("own_sensors:NOT_A_CLASS", "is no class derived from OwnMeasurement"),
        ("own_sensors:Three", "has the name 'three_x', which is no word for a row of a table"),
        ("own_sensors:Flat", r"of shapes \(101,\) and \(101,\)"),
        ("own_sensors:Late", "has no reading between the start of the replay and its end"),
    ],
)
def test_what_is_none_is_told_in_a_sentence(word: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        replayed(word, 20.0)
