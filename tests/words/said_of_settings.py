"""Mistakes in settings: files, ``--set``, presets, and simulated dives that cannot be."""

from pathlib import Path

from as_text import Cases, refusal

import insdvl_replay
from insdvl_replay.batch.demo import make_dives
from insdvl_replay.batch.dive_paths import shared_settings
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.schemas import lines_for_editors
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.settings_layers import LOCAL_SETTINGS
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import LostBeam
from insdvl_replay.studies.montecarlo import make_setup

RUN = '[filters.a]\naiding = ["velocity"]\n[filters.b]\n'
"""Settings with a baseline, before the keys of another filter."""
IN_A_FILE = (
    "[dvl]\nscle = 1.0",
    "[dlv]\nscale = 1.0",
    "[dvl]\nqqqqqqqqqqqq = 1",
    "[span]\nfrom = 3.0",
    '[filters.a]\naidin = ["velocity"]',
    "dvl = 3",
    "filters = 3",
    "[filters]\na = 3",
    "[filters.a]\ngate_probability = 1.0",
    '[dvl]\nlever_arm_m = [0.0, "x", 0.0]',
    "[dvl]\nscale = 0",
    "[dvl]\nlever_arm_m = [0, 0, inf]",
    "[noise]\naccel_white_mps_rts = 1e999",
    "[dvl",
    '[filters.b]\naiding = ["velocity", "acceleration"]\nacceleration = { window = 1 }',
    '[filters.b]\naiding = ["acceleration"]',
    '[filters.b]\naiding = ["acceleration"]\nacceleration = { window = 3, order = 3 }',
    '[filters.b]\naiding = ["heading", "my:Own"]\nstates = ["position", "dvl_yaw"]',
    '[filters.a]\naiding = ["velocity"]\nstates = ["position", "depth_zero"]',
    '[filters.a-b]\naiding = ["velocity"]',
    '[filters.a]\nsolution = "/o"',
    f'{RUN}solution = "/o"\naiding = ["velocity"]',
    f"{RUN}solution = {{ align = 'none' }}",
    f"{RUN}solution = {{ topic = '/o', file = '/o.tum' }}",
    f"{RUN}solution = {{ tpic = '/o' }}",
    f"{RUN}solution = {{ file = 'o.tum', heading = 'h' }}",
    f"{RUN}solution = 'nowhere.tum'",
    "[filters.a]\naiding = []",
    "[filters]",
    "dvl.axes = 'frd'\ndvl.kind = 'beam'",
    "[filters.a]\naiding = ['velocity', 'accel']",
    "[dvl]\n\n'scale - at `$.kind`' = 1",
    '[evaluation]\nheld_out = "depth"',
    "[evaluation]\nheld_out = ['gps']",
    f"[dvl]\nscale = {'9' * 5000}",
    f"[dvl]\nscale = {'[' * 5000}",
)
OWN = '"own_sensors:Speed"'
PROGRAM = f'{RUN}program = ["./mine", "{{dive}}", "{{solution}}"]'
PROGRAMS = (
    'filters.mine.program=["./mine", "{dvl_csv}"]',
    'filters.mine={program=["./mine", "{imu_csv}", "{solution}"], input="log"}',
)
ON_THE_COMMAND_LINE = (
    "dvl.scale",
    "scale=3",
    "dvl.scle=3",
    "dvl.kind=boat",
    "dvl.scale=nan",
    "filters.aided.acceleration.window=1",
    'filters.b.aiding=["beam"]',
    "dvl.noise=0.01",
    "imu.gyro_noise=1e-3",
    "gps.topic='/fix'",
    "evaluation.held_out=position",
    "evaluation.held_out=[position,depth]",
    "dvl.lever_arm_m=1,2,0.5",
    "dvl.lever_arm_m=1",
    f"dvl.scale={'9' * 5000}",
    f"dvl.scale={'[' * 5000}",
    "dvl.velocity_sd_mps=1e308",
    "dvl.topic=\udcff",
    f"filters.mine.aiding=[{OWN},{OWN}]",
    f'filters.mine.aiding=[{OWN},"velocty"]',
    'topics.beacon.topic="/usbl/range"',
    'topics.a-b.topic="/x"',
)
IMPOSSIBLE_DIVES = (
    {"scenario": "figure-eigth"},
    {"scenario": "zz"},
    {"grade": "mens"},
    {"duration_s": -1.0},
    {"duration_s": float("nan")},
    {"duration_s": 0.005},
    {"imu_rate_hz": 0.0},
    {"dvl_rate_hz": -2.0},
    {"reference_rate_hz": float("inf")},
    {"outages": [(20.0, 10.0)]},
    {"lost_beams": [LostBeam(4, 0.0, 1.0)]},
    {"duration_s": 300.0, "lost_beams": [LostBeam(0, 400.0, 500.0)]},
    {"duration_s": 300.0, "outages": [(-20.0, 0.0)]},
    {"seed": -3},
)


def said_of_settings(folder: Path) -> Cases:
    """Return what is said of each mistake."""
    file = folder / "vehicle.toml"
    for text in IN_A_FILE:
        file.write_text(text, "utf-8")
        yield f"in a file: {text}".replace("\n", " / "), refusal(load_config, file=file)
    (folder / "image.toml").write_bytes(b"\x89PNG\xff")
    for name in ("absent.toml", "image.toml"):
        yield name, refusal(load_config, file=folder / name)
    local = folder / LOCAL_SETTINGS
    for text in ("[dvl", PROGRAM):
        local.write_text(text, "utf-8")
        yield f"next to a dive: {text!r}", refusal(load_config, file=local, unnamed=local)
    local.unlink()
    local.mkdir()
    yield "next to a dive: a folder", refusal(load_config, file=local, unnamed=local)
    dives = [FoundDive(folder / name, settings=folder / name) for name in ("one", "two")]
    yield "dives of two vehicles", refusal(shared_settings, dives, "calibrate")
    for override in PROGRAMS:
        said = refusal(load_config, overrides=[override], allow_code=True)
        yield f"--set {override!r}, with --allow-code", said
    yield "schema report --toml", refusal(lines_for_editors, "report")
    yield "a demonstration in another folder", refusal(make_dives, folder)
    for override in ON_THE_COMMAND_LINE:
        yield f"--set {override!r}", refusal(load_config, overrides=[override])
    yield "None in Python", refusal(insdvl_replay.load_config, settings={"dvl.lever_arm_m": None})
    yield "preset phog", refusal(load_config, "phog")
    for dive in IMPOSSIBLE_DIVES:
        yield (
            f"a dive of {dive}",
            refusal(simulate_dive, **{"scenario": "static", "duration_s": 10.0, **dive}),
        )
    yield (
        "a study of the grade matchd",
        refusal(make_setup, "straight", load_config("fog"), "matchd"),
    )
