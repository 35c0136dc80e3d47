"""The settings of the Snapir for the public benchmark, from its published tables: `make benchmark-settings`.

The three tables of a dive have no common clock. The attitudes of the reference and the gyros tell the clock of the
reference, and its velocities tell that of the DVL to some 20 ms. A calibration of the quiet dives together then finds
how the DVL is built in. It also finds the delay of each dive, to a millisecond.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmark_dives import Place, name_of
from msgspec.structs import asdict
from written import PROJECT

from insdvl_replay.calibration.calibration import Calibration, calibrate
from insdvl_replay.calibration.found import with_values
from insdvl_replay.calibration.innovations import Geometry, ReadDive, read_dive
from insdvl_replay.calibration.reference import with_reference
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.errors import UserError
from insdvl_replay.inspection.settings import with_settings
from insdvl_replay.inspection.table_clocks import table_clock_settings
from insdvl_replay.logs.formats.recording import open_recording

DATA_SET = "snapir"
NOISY = ("snapir_09", "snapir_11")  # whose DVL is noisy: they do not tell how it is built in
OF_DVL = ("arm", "mounting", "delay", "scale")
OF_REFERENCE = ("reference_arm",)
# The beams' noise of the roughest dive is a tenth above that of all.
ROUGHEST = 1.1
HEAD = f"# Written by `make benchmark-settings`, from {DATA_SET}.toml and the published tables of all dives.\n"


def with_clocks(folder: Path, base: Config) -> Config:
    """Return the settings with the rates of a dive's tables, and with the offsets between their clocks."""
    return with_settings(base, table_clock_settings(open_recording(folder), base))


def calibrated(reads: Sequence[ReadDive], base: Config, groups: Sequence[str]) -> Calibration:
    """Calibrate dives that have clocks of their own; delays are changes of these."""
    return calibrate([read.innovations() for read in reads], base, groups)


def with_geometry(read: ReadDive, dvl: Geometry) -> ReadDive:
    """Return a dive with the arm, mounting and scale of the DVL, and with a latency of its own."""
    found = asdict(dvl)
    del found["latency_s"]
    return read.with_config(with_values(read.config, "dvl", **found))


def rounded(dvl: Geometry) -> Geometry:
    """Return a geometry to tenths of a millimetre and thousandths of a degree."""
    forward_m, starboard_m, down_m = dvl.lever_arm_m
    roll_deg, pitch_deg, yaw_deg = dvl.mounting_rpy_deg
    return Geometry(
        latency_s=dvl.latency_s,
        lever_arm_m=(round(forward_m, 4), round(starboard_m, 4), round(down_m, 4)),
        mounting_rpy_deg=(round(roll_deg, 3), round(pitch_deg, 3), round(yaw_deg, 3)),
        scale=round(dvl.scale, 5),
    )


def reference_arm_m(found: Calibration, reads: Sequence[ReadDive]) -> tuple[float, float, float]:
    """Return where the point of the reference is, seen from the IMU, m."""
    asked = [read.innovations() for read in reads]
    compared = with_reference(found, reads, asked, (*OF_DVL, *OF_REFERENCE)).reference
    assert compared is not None
    forward_m, starboard_m, down_m = compared.after.lever_arm_m
    return round(forward_m, 3), round(starboard_m, 3), round(down_m, 3)


def settings_of_dives(folders: Sequence[Path], base: Config) -> list[Config]:
    """Find the settings of each dive."""
    reads = [read_dive(folder, with_clocks(folder, base)) for folder in folders]
    quiet = [read for read in reads if read.dive.name not in NOISY]
    found = calibrated(quiet, base, OF_DVL)
    arm_m = reference_arm_m(found, quiet)
    built_in = [with_geometry(read, rounded(found.after)) for read in reads]
    delays = calibrated(built_in, base, ("delay",)).dives
    settings = []
    for read, delay in zip(built_in, delays, strict=True):
        assert delay.delay_s is not None
        latency_s = round(read.config.dvl.latency_s + delay.delay_s, 4)
        config = with_values(read.config, "dvl", latency_s=latency_s)
        settings.append(with_values(config, "reference", lever_arm_m=arm_m))
    beam_sd_mps = round(ROUGHEST * fitted_beam_sd_mps(folders, settings, base), 4)
    return [with_values(config, "dvl", beam_sd_mps=beam_sd_mps) for config in settings]


def fitted_beam_sd_mps(folders: Sequence[Path], settings: Sequence[Config], base: Config) -> float:
    """Return the noise of a beam with the highest likelihood over dives with their own clocks."""
    reads = []
    for folder, config in zip(folders, settings, strict=True):
        reads.append(read_dive(folder, config))
    return calibrated(reads, base, ("noise",)).noise.after["beam_sd_mps"]


def settings_text(config: Config) -> str:
    """Write settings without the comments on their keys."""
    lines = []
    for line in render_toml(config, changed_only=True).splitlines():
        lines.append(re.sub(r"\s+# .*", "", line))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the settings of each dive."""
    place = Place()
    dives = place.data_sets[DATA_SET]
    folders = []
    for dive in dives:
        log = place.logs[name_of(dive)]
        if isinstance(log, UserError):
            sys.exit(f"error: {name_of(dive)}: {log}")
        folders.append(log)
    base = load_config(file=place.public / "settings" / f"{DATA_SET}.toml")
    for folder, config in zip(folders, settings_of_dives(folders, base), strict=True):
        file = place.public / "settings" / f"{folder.name}.toml"
        file.write_text(HEAD + settings_text(config), "utf-8")
        sys.stdout.write(f"wrote {file.relative_to(PROJECT)}\n")


if __name__ == "__main__":
    main()
