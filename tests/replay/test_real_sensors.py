"""Depths and fixes of real vehicles: read as their messages have them, used, and withheld one by one."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from insdvl_replay.core.config import Config, Depth, Dvl, Filter, Imu, Reference
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs import read_dive
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.preparation.replay import Replay, replay_log

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
EXAMPLES = Path(__file__).parents[2] / "examples"

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason="the real logs in ../shared/data are not here"
)


def square(held_out: str, *, aided_by: tuple[str, ...]) -> Replay:
    """The Blueye's square, whose fixes are the reference's, too."""
    overrides = [
        f"filters.more.aiding={['velocity', *aided_by]}".replace("'", '"'),
        f'evaluation.held_out=["{held_out}"]',
        'position.topic="blueye.protocol.PositionEstimateTel"',
        "position.sd_m=0.5",
        "depth.sd_m=0.05",
    ]
    return replay_log(
        DATA / "blueye_x3" / "auto_square.mcap",
        load_config(file=EXAMPLES / "blueye_x3.toml", overrides=overrides),
    )


def evidence(replay: Replay, quantity: str) -> EvidenceRow:
    return next(
        row for row in replay.tables.evidence if row.filter == "more" and row.quantity == quantity
    )


def test_fixes_that_are_held_out_say_what_the_reference_says() -> None:
    """They are its own: what drifts by 1.5 m in a minute against the one does against the other."""
    replay = square("position", aided_by=("depth",))
    held_out, against = evidence(replay, "held_out_position"), evidence(replay, "drift_60s")
    assert held_out.samples > 20
    assert held_out.baseline == pytest.approx(against.baseline, rel=0.25)
    assert [note.code for note in replay.notes if note.code.endswith("_is_reference")] == [
        "position_is_reference"
    ]
    assert held_out.ratio == pytest.approx(1.0, abs=0.02)
    assert replay.verdicts["more"].verdict != "not evaluated"
    depth = next(one for one in replay.histories[2].innovations if one.measurement == "depth")
    assert depth.used.all()
    assert np.sqrt(np.mean(depth.innovation**2)) < 0.05


def test_a_depth_that_is_held_out_says_how_the_height_drifts() -> None:
    replay = square("depth", aided_by=("position",))
    held_out = evidence(replay, "held_out_depth")
    assert held_out.samples > 20
    assert held_out.baseline is not None
    assert 0.01 < held_out.baseline < 0.5
    met = next(
        one for one in replay.histories[0].innovations if one.measurement == "held_out_depth"
    )
    assert len(met.nis) > 1000
    assert replay.verdicts["more"].verdict == "not evaluated"
    assert "position" in replay.verdicts["more"].sentence


def test_a_depth_of_the_coug_is_that_of_its_messages() -> None:
    """Its IMU is too slow for an INS; the depth is read all the same."""
    path = DATA / "cougars" / "so_lastbag.mcap"
    config = Config(
        imu=Imu(stamp="log_time"),
        dvl=Dvl(stamp="log_time"),
        reference=Reference(topic="/coug2/odom", stamp="log_time"),
        depth=Depth(topic="/coug2/depth_data", stamp="log_time"),
        filters={"deep": Filter(aiding=("velocity", "depth"))},
    )
    read = read_dive(path, config).sensors["depth"]
    with path.open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
            topics=["/coug2/depth_data"]
        )
        theirs = {
            message.log_time: -decoded.pose.pose.position.z for _, _, message, decoded in messages
        }
    assert len(read.time_ns) == len(theirs) == 1566
    np.testing.assert_array_equal(
        read.values[:, 0], [theirs[time] for time in read.time_ns.tolist()]
    )


@pytest.mark.parametrize("run", ["run_1", "run_2"])
def test_a_depth_of_the_subjugator_holds_its_height(run: str) -> None:
    overrides = [
        'filters.deep.aiding=["velocity","depth"]',
        'depth.topic="/depth/pose"',
        "depth.sd_m=0.02",
    ]
    replay = replay_log(
        DATA / "ufmil" / f"{run}.mcap",
        load_config(file=EXAMPLES / "ufmil.toml", overrides=overrides),
    )
    deep = replay.histories[-1]
    depth = next(one for one in deep.innovations if one.measurement == "depth")
    assert depth.used.all()
    assert np.sqrt(np.mean(depth.innovation**2)) < 0.05


@pytest.mark.parametrize("run", ["run_1", "run_2"])
def test_the_ahrs_of_the_subjugator_is_as_level_as_gravity_says(run: str) -> None:
    """Its quaternion turns axes forward-starboard-down, unlike those of its type: a warning says so until it is set."""
    log, source = DATA / "ufmil" / f"{run}.mcap", "initial.source=sensor"
    replays = {
        name: replay_log(log, load_config(file=EXAMPLES / "ufmil.toml", overrides=overrides))
        for name, overrides in {
            "level": [],
            "as its type": [source],
            "mounted": [source, "heading.mounting_rpy_deg=[180,0,0]"],
        }.items()
    }
    contradicted = {
        name: [note.code for note in replay.notes if note.code == "start_tilt_contradiction"]
        for name, replay in replays.items()
    }
    assert contradicted == {
        "level": [],
        "as its type": ["start_tilt_contradiction"],
        "mounted": [],
    }
    starts_deg = {
        name: np.rad2deg(rpy_from_mat(replay.histories[0].mat_nb[0]))
        for name, replay in replays.items()
    }
    np.testing.assert_allclose(starts_deg["mounted"], starts_deg["level"], atol=0.15)
    ratios = [replays[name].tables.consistency[0].mean_nis for name in ("mounted", "level")]
    assert ratios[0] == pytest.approx(ratios[1], rel=0.02)


@pytest.mark.parametrize(("dive", "stuck"), [("x_1", 678), ("rotation_z_1", 936)])
def test_a_depth_that_never_changes_is_stuck(dive: str, stuck: int) -> None:
    by_recorder = [f"{role}.stamp=log_time" for role in ("imu", "dvl", "reference", "depth")]
    overrides = [
        "depth.topic=/depth",
        "depth.height=data",
        'filters.deep.aiding=["velocity","depth"]',
        *by_recorder,
    ]
    notes = read_checked_dive(
        DATA / "stanford_auv" / f"{dive}.mcap", load_config("mems", overrides=overrides)
    ).notes
    assert [note.count for note in notes if note.code == "depth_stuck"] == [stuck]
