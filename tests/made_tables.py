"""Dives as tables: the same numbers in every format that is read, and ways to damage text."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from insdvl_replay.core.config import Config, Dvl, Evaluation, Imu, Initial, Reference
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.sim.dive import simulate_dive

FORMATS = ("csv", "tsv", "npz", "parquet", "mat")
SECTIONS = ("imu", "dvl", "reference")
Tables = dict[str, dict[str, NDArray[Any]]]
"""The columns of each table by their titles."""


@cache
def simulated() -> Dive:
    return simulate_dive("calibration", seed=4, duration_s=60.0, imu_rate_hz=50.0)


def recorded(folder: Path) -> tuple[Path, Dive]:
    """Write the dive as a log, and read it as a replay does."""
    path = folder / "dive.mcap"
    write_dive(path, simulated())
    return path, read_dive(path, Config())


def tables_of(dive: Dive) -> Tables:
    """Lay out a dive as tables, with whole nanoseconds."""
    beams, reference = dive.dvl.beam_velocity_mps, dive.reference
    assert beams is not None
    assert reference is not None
    axes = (("x", 0), ("y", 1), ("z", 2))
    forces = {f"Acc {name} [m/s^2]": dive.imu.specific_force_b[:, i] for name, i in axes}
    rates = {f"Gyro {name} [rad/s]": dive.imu.angular_rate_b[:, i] for name, i in axes}
    latitude, longitude, height_m = reference.position.T
    angles = dict(
        zip(
            ("Roll [rad]", "Pitch [rad]", "Yaw [rad]"),
            rpy_from_mat(reference.mat_nb).T,
            strict=True,
        )
    )
    velocities = {
        f"V {name}": reference.velocity_n[:, i] for i, name in enumerate(("north", "east", "down"))
    }
    place = {"Latitude [rad]": latitude, "Longitude [rad]": longitude, "Height [m]": height_m}
    return {
        "imu": {"Time [ns]": dive.imu.time_ns, **forces, **rates},
        "dvl": {
            "Time [ns]": dive.dvl.time_ns,
            **{f"Beam {i + 1}": column for i, column in enumerate(beams.T)},
        },
        "reference": {"Time [ns]": reference.time_ns, **place, **velocities, **angles},
    }


def settings(topics: dict[str, str]) -> Config:
    """Name the fields of the tables, by name, title or number."""
    beams = "2, 3, 4, 5" if topics["dvl"].endswith(".csv") else "beam_1, beam_2, beam_3, beam_4"
    return Config(
        imu=Imu(
            topic=topics["imu"],
            specific_force="acc_x, acc_y, acc_z",
            angular_rate="Gyro x [rad/s], Gyro y [rad/s], Gyro z [rad/s]",
        ),
        dvl=Dvl(topic=topics["dvl"], beam_velocity=beams, beam_tilt_deg=30.0),
        reference=Reference(
            topic=topics["reference"], latitude="latitude", longitude="longitude", height="height",
            velocity_n="v_north, v_east, v_down", roll="roll", pitch="pitch", heading="yaw", angle_unit="rad",
        ),
        initial=Initial(),
        evaluation=Evaluation(starts=1),
    )  # fmt: skip


def write_tables(folder: Path, tables: Tables, ending: str) -> tuple[Path, dict[str, str]]:
    """Write tables in a format; return what to read, and the topic of each table."""
    folder.mkdir(exist_ok=True)
    single, topics = folder / f"dive.{ending}", {name: f"dive.{ending}/{name}" for name in tables}
    plain = {
        name: {_plain(title): column for title, column in table.items()}
        for name, table in tables.items()
    }
    if ending == "npz":
        np.savez(
            single,
            **{
                f"{name}_{title}": column
                for name in plain
                for title, column in plain[name].items()
            },
        )
    elif ending == "mat":
        from scipy.io import savemat

        savemat(single, plain)
    else:
        for name, table in tables.items():
            path, frame = folder / f"{name}.{ending}", pd.DataFrame(table)
            if ending == "parquet":
                frame.to_parquet(path)
            else:
                frame.to_csv(path, sep="\t" if ending == "tsv" else ",", index=False)
        return folder, {name: f"{name}.{ending}" for name in tables}
    return single, topics


def _plain(title: str) -> str:
    """A title as the name of a variable, with its unit where it is a time."""
    return title.replace("Time [ns]", "time_ns").partition(" [")[0].replace(" ", "_").lower()


# --- Damage to a table of text, by its lines.

Lines = list[str]
Harm = Callable[[Lines, np.random.Generator], str]


def _some(lines: Lines, rng: np.random.Generator) -> int:
    return int(rng.integers(2, len(lines) - 2))


def cut(lines: Lines, rng: np.random.Generator) -> str:
    text = "\n".join(lines)
    at = int(rng.integers(len(text) // 2, len(text)))
    return text[: at - 1] if text[at - 1] == "\n" else text[:at]


def text_in_number(lines: Lines, rng: np.random.Generator) -> str:
    row = _some(lines, rng)
    cells = lines[row].split(",")
    column = int(rng.integers(len(cells)))
    cells[column] = str(
        rng.choice(
            ["err", "1.2.3", f"{cells[column][:3]}O{cells[column][3:]}", "--", "0x1f", "12 34"]
        )
    )
    lines[row] = ",".join(cells)
    return "\n".join(lines) + "\n"


def missing_cell(lines: Lines, rng: np.random.Generator) -> str:
    row = _some(lines, rng)
    cells = lines[row].split(",")
    del cells[int(rng.integers(len(cells)))]
    lines[row] = ",".join(cells)
    return "\n".join(lines) + "\n"


def missing_column(lines: Lines, rng: np.random.Generator) -> str:
    column, first = int(rng.integers(len(lines[0].split(",")))), int(rng.integers(2))
    for row in range(first, len(lines)):
        cells = lines[row].split(",")
        del cells[column]
        lines[row] = ",".join(cells)
    return "\n".join(lines) + "\n"


def not_a_number(lines: Lines, rng: np.random.Generator) -> str:
    for row in {_some(lines, rng) for _ in range(int(rng.integers(1, 9)))}:
        cells = lines[row].split(",")
        cells[int(rng.integers(len(cells)))] = str(rng.choice(["nan", "", "NaN", "inf", "NA"]))
        lines[row] = ",".join(cells)
    return "\n".join(lines) + "\n"


def wrong_separator(lines: Lines, rng: np.random.Generator) -> str:
    mark, first = str(rng.choice([";", "\t", "|", " "])), int(rng.integers(2))
    rows = range(first, len(lines)) if rng.integers(2) else [_some(lines, rng)]
    for row in rows:
        lines[row] = lines[row].replace(",", mark)
    return "\n".join(lines) + "\n"


def decimal_commas(lines: Lines, rng: np.random.Generator) -> str:
    if rng.integers(2):
        lines = [line.replace(",", ";") for line in lines]
    return "\n".join([lines[0], *(line.replace(".", ",") for line in lines[1:])]) + "\n"


def repeated_times(lines: Lines, rng: np.random.Generator) -> str:
    row, count = _some(lines, rng), int(rng.integers(1, 5))
    time = lines[row].split(",")[0]
    for other in range(row + 1, min(row + 1 + count, len(lines))):
        lines[other] = ",".join([time, *lines[other].split(",")[1:]])
    return "\n".join(lines) + "\n"


def two_headers(lines: Lines, rng: np.random.Generator) -> str:
    second = ",".join(["unit"] * len(lines[0].split(","))) if rng.integers(2) else lines[0]
    lines.insert(1 if rng.integers(2) else _some(lines, rng), second)
    return "\n".join(lines) + "\n"


HARMS: tuple[Harm, ...] = (
    cut, text_in_number, missing_cell, missing_column, not_a_number, wrong_separator, decimal_commas, repeated_times,
    two_headers,
)  # fmt: skip
