"""What a calibration must be able to do, line by line: simulated dives whose truth is known, and real ones.

`make calibration` runs this, which takes some ten minutes. Real dives are looked for in ``../shared/data``; lines of
those that are not there say so.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from unittest.mock import patch

import numpy as np
from built_in import (
    ARM_M,
    CONFIG,
    DELAY_S,
    SCALE,
    TRUTH,
    WHITE,
    YAW_DEG,
    ReadDive,
    as_read,
    built_in_otherwise,
    shown,
)
from results import machine, table, write_part

from insdvl_replay.calibration.calibration import Calibration, calibrate, held_out_row
from insdvl_replay.calibration.certainty import certainty_of
from insdvl_replay.calibration.fit import likeliest_mounting, with_mounting
from insdvl_replay.calibration.innovations import NAMES, PARAMETERS, read_dive
from insdvl_replay.calibration.noise import INERTIAL
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.sim import dive as sim_dive
from insdvl_replay.sim.dive import add_errors, exact_dive, late_and_long
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors
from insdvl_replay.sim.trajectories import Scenario, Segment, Wave, turn

SEEDS = range(6000, 6020)
STRAIGHT_SEEDS = range(20)
COMMAND_SEEDS = range(1, 5)
EXAMPLES = Path(__file__).parents[1] / "examples"
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
TURNS_DEG = (120.0, -150.0, 180.0, -90.0, 150.0, -180.0, 90.0, -120.0)
MOTIONS = {
    "aggressive": Scenario(
        "fast turns, changes of speed, large roll and pitch",
        300.0,
        Wave(1.5, 1.2, 19.0),
        tuple(
            part for angle_deg in TURNS_DEG * 2 for part in (Segment(10.0), turn(angle_deg, 30.0))
        ),
        roll_deg=Wave(0.0, 15.0, 9.0),
        pitch_deg=Wave(0.0, 12.0, 14.0),
        sway_mps=Wave(0.0, 0.4, 11.0),
        heave_mps=Wave(0.0, 0.4, 8.0),
    ),
    "hover": Scenario(
        "in one place, with turns on the spot",
        300.0,
        Wave(0.0, 0.05, 23.0),
        tuple(
            part
            for angle_deg in (60.0, -60.0, 90.0, -90.0) * 2
            for part in (Segment(25.0), turn(angle_deg, 8.0))
        ),
        roll_deg=Wave(0.0, 1.5, 6.0),
        pitch_deg=Wave(0.0, 1.0, 5.0),
        sway_mps=Wave(0.0, 0.05, 17.0),
        heave_mps=Wave(0.0, 0.04, 13.0),
    ),
    "waves": Scenario(
        "a slow way near the surface, in swell",
        300.0,
        Wave(1.0, 0.3, 7.0),
        tuple(
            part
            for angle_deg in (90.0, 90.0, -90.0, -90.0)
            for part in (Segment(50.0), turn(angle_deg, 10.0))
        ),
        roll_deg=Wave(0.0, 6.0, 7.0),
        pitch_deg=Wave(0.0, 4.0, 8.0),
        sway_mps=Wave(0.0, 0.2, 7.0),
        heave_mps=Wave(0.0, 0.3, 8.0),
    ),
}
"""Motions beside those of the simulator's own scenarios."""
COLUMNS = ("what", "asked for", "measured")

Line = tuple[str, str, str]


def main() -> None:
    """Measure, print and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    rows = [f"| {' | '.join(line)} |" for part in PARTS for line in part()]
    about = (
        f"DVL built in 0.3, -0.1, 0.2 m from the IMU, turned by 1.5 deg, 0.12 s late and 2 % long, of which the "
        f"configuration (`--preset fog`) knows nothing, on {len(SEEDS)} simulated dives of each kind; errors of what "
        f"is proposed over their sds are rms over the dives. {machine()}; shared cores."
    )
    part = "\n".join(["# Calibration", "", about, "", *table(COLUMNS, rows)])
    write_part(part)
    sys.stdout.write(f"{part}\n")


def found_of(*dives: ReadDive) -> Calibration:
    """Calibrate all that can be."""
    return calibrate([dive.innovations() for dive in dives], dives[0].config)


def is_proposed(found: Calibration) -> Floats:
    """Say which of the eight are proposed, 1 or NaN, shape (8,)."""
    return np.array([1.0 if row.status == Estimated.ESTIMATED else np.nan for row in found.rows])


def errors_over_sds() -> Iterator[Line]:
    """Simulated dives whose beams are perfect but for white noise, and such as makers say."""
    for scenario in ("calibration", "figure-eight"):
        for name, beams in (("beams as makers say", DvlErrors()), ("perfect beams", WHITE)):
            found = list(
                parallel_map(
                    lambda seed, args=(scenario, beams): found_of(
                        built_in_otherwise(args[0], seed, args[1])
                    ),
                    SEEDS,
                )
            )
            over = np.array([_over_sds(of_one, perfect_beams=beams is WHITE) for of_one in found])
            rms = np.sqrt(np.nanmean(over**2, axis=0))
            told = ", ".join(
                f"{parameter} {size:.2f}" for parameter, size in zip(NAMES, rms, strict=True)
            )
            held = [
                parameter
                for parameter, of_one in zip(NAMES, over.T, strict=True)
                if np.isnan(of_one).any()
            ]
            yield (
                f"errors over sds, {scenario}, {name}",
                "0.6 to 1.5 each",
                f"{told}; largest of {np.isfinite(over).sum()} {np.nanmax(np.abs(over)):.2f}; held on some: "
                f"{', '.join(held) or 'none'}",
            )
            inside = np.nanmax(np.abs(over), axis=1) < 3.0
            yield (
                f"what was put in, {scenario}, {name}",
                "within 3 sds",
                f"{inside.sum()} of {len(inside)} dives",
            )


def _over_sds(found: Calibration, *, perfect_beams: bool) -> Floats:
    """Return errors over sds, NaN of what is held, shape (8,).

    These IMUs have no errors of scale and alignment: the sds are without them, and without those of perfect beams.
    """
    beams = np.array([finite(row.beams_sd) for row in found.rows]) / shown(
        np.ones(len(PARAMETERS))
    )
    said = np.hypot(certainty_of(found.fit).sd, 0.0 if perfect_beams else beams)
    return is_proposed(found) * (found.change - TRUTH) / said


def _said(found: Calibration) -> Floats:
    return np.array([finite(row.sd) for row in found.rows]) / shown(np.ones(len(PARAMETERS)))


def with_estimated_imu_errors() -> Iterator[Line]:
    """Tactical IMUs whose scales are 1500 ppm off and whose axes 1 mrad (sds), with beams as makers say."""
    for name in MOTIONS:
        with patch.object(sim_dive, "SCENARIOS", MOTIONS):
            exact = exact_dive(name, lever_arm_m=ARM_M, mounting_rpy_deg=(0.0, 0.0, YAW_DEG))
        found = list(
            parallel_map(lambda seed, exact=exact: found_of(with_imu_errors(exact, seed)), SEEDS)
        )
        over = np.array([is_proposed(one) * (one.change - TRUTH) / _said(one) for one in found])
        told = []
        for parameter, sizes in zip(NAMES, over.T, strict=True):
            proposed = sizes[np.isfinite(sizes)]
            size = f"{np.sqrt(np.mean(proposed**2)):.2f}" if len(proposed) else "-"
            left = len(sizes) - len(proposed)
            told.append(f"{parameter} {size}{f' (not determined on {left})' if left else ''}")
        yield (
            f"errors over sds, IMU of 1500 ppm and 1 mrad, {name}",
            "0.6 to 1.5 each",
            ", ".join(told),
        )
        for key, true in _true_noise("tactical").items():
            rows = [row for one in found for row in one.noise_rows if row.parameter == key]
            ratios = [row.after / true for row in rows if row.status == Estimated.ESTIMATED]
            off = [finite(row.sd) / row.after for row in rows if row.status == Estimated.ESTIMATED]
            yield (
                f"{key} found over true, IMU of 1500 ppm and 1 mrad, {name}",
                "0.5 to 2, or not determined",
                f"{f'{min(ratios):.2f} to {max(ratios):.2f}, sd {np.median(off):.0%}; ' if ratios else ''}"
                f"not determined on {len(found) - len(ratios)} of {len(found)}",
            )


def _true_noise(grade: str) -> dict[str, float]:
    errors = GRADES[grade]
    return {key: getattr(errors, key) for key in INERTIAL} | {
        "beam_sd_mps": DvlErrors().beam_sd_mps
    }


def with_imu_errors(exact: Dive, seed: int) -> ReadDive:
    """Give a dive an IMU that has other scales than it says, and axes that are not at right angles."""
    rng = np.random.default_rng((seed, 77))
    imu = exact.imu
    turns = [
        np.eye(3) + np.where(np.eye(3) > 0.0, np.diag(1.5e-3 * along), 1e-3 * across)
        for across, along in (
            (rng.standard_normal((3, 3)), rng.standard_normal(3)) for _ in range(2)
        )
    ]
    imu = replace(
        imu,
        specific_force_b=imu.specific_force_b @ turns[0].T,
        angular_rate_b=imu.angular_rate_b @ turns[1].T,
    )
    dive = add_errors(replace(exact, imu=imu), GRADES["tactical"], DvlErrors(), seed)
    return as_read(late_and_long(dive, DELAY_S, SCALE), load_config("tactical"))


def straight_lines() -> Iterator[Line]:
    """Nothing may move."""
    found = [
        found_of(built_in_otherwise("straight", seed, DvlErrors())) for seed in STRAIGHT_SEEDS
    ]
    moved = sum(bool(one.change.any()) or one.proposes_noise for one in found)
    yield (
        "straight line",
        "nothing is proposed",
        f"{moved} of {len(found)} dives propose something",
    )


def wild_pings() -> Iterator[Line]:
    """One ping in twenty reads ten times too much."""
    moved = []
    for seed in range(6000, 6005):
        read = built_in_otherwise("figure-eight", seed, DvlErrors())
        beams_mps = read.dive.dvl.beam_velocity_mps
        assert beams_mps is not None
        wild = np.random.default_rng(seed).random(len(beams_mps)) < 0.05
        dvl = replace(
            read.dive.dvl, beam_velocity_mps=np.where(wild[:, None], 10.0 * beams_mps, beams_mps)
        )
        before = found_of(read)
        after = found_of(replace(read, dive=replace(read.dive, dvl=dvl)))
        moved.append(np.max(np.abs((after.fit.change(0) - before.fit.change(0)) / _said(before))))
    yield (
        "5 % of the pings 10 times too large",
        "estimates move by less than 1 sd",
        f"at most {max(moved):.2f} sd of 5 dives",
    )


def right_angles() -> Iterator[Line]:
    """A mounting that is off by 90 deg."""
    row = NAMES.index("mounting_z")
    right = 0
    refused = 0
    found_again = 0
    for seed in range(6000, 6005):
        turned = built_in_otherwise("figure-eight", seed, DvlErrors(), yaw_deg=90.0)
        astray = found_of(turned)
        refused += astray.rows[row].status != Estimated.ESTIMATED
        right += abs(astray.after.mounting_rpy_deg[2] - 90.0) < 1.0
        found = found_of(turned.with_config(with_mounting(CONFIG, likeliest_mounting([turned]))))
        found_again += abs(found.after.mounting_rpy_deg[2] - 90.0) < 1.0
    said = f"within 1 deg on {right}, refused on {refused} of 5 dives"
    yield "90 deg off in heading", "found, or refused", said
    yield "90 deg off, `--mounting unknown`", "found", f"within 1 deg on {found_again} of 5 dives"


def snapir() -> Iterator[Line]:
    """Fitted on four dives, tried on three others."""
    if not (DATA / "snapir").is_dir():
        yield "Snapir", "", "its dives are not here"
        return
    unknown = ["dvl.lever_arm_m=[-1.834,0,0.3]", "dvl.mounting_rpy_deg=[0,0,0]"]
    config = load_config("fog", EXAMPLES / "snapir.toml", unknown)
    dives = {
        name: read_dive(DATA / f"snapir/snapir_{name}.mcap", config)
        for name in ("01", "02", "05", "08", "07", "09", "11")
    }
    found = found_of(*(dives[name] for name in ("01", "02", "05", "08")))
    birge = max(finite(row.birge) for row in found.rows if row.parameter.startswith("arm"))
    yield "Snapir, four dives: Birge ratio of the arm", "below 3", f"{birge:.2f}"
    rows = [held_out_row(dives[name], found.change, found.noise) for name in ("07", "09", "11")]
    ratios = [finite(row.nis_per_dof_before) / finite(row.nis_per_dof_after) for row in rows]
    drifts = [finite(row.drift_before_m) / finite(row.drift_after_m) for row in rows]
    noisy = [finite(row.nis_per_dof_noise) for row in rows]
    yield (
        "Snapir, three other dives: NIS, the noise as configured",
        "10 times lower",
        _listed(ratios, " times"),
    )
    yield (
        "Snapir, three other dives: drift in 60 s",
        "halved in the median",
        _listed(drifts, " times less"),
    )
    yield (
        "Snapir, three other dives: NIS / dof with the noise of the four",
        "near 1",
        _listed(noisy),
    )


def _listed(values: Sequence[float], unit: str = "") -> str:
    return ", ".join(f"{value:.3g}{unit}" for value in values)


def real_vehicles() -> Iterator[Line]:
    """Vehicles whose papers say where the DVL sits, or how it is turned."""
    if not (DATA / "blueye_x3").is_dir() or not (DATA / "ufmil").is_dir():
        yield "Blueye and ufmil", "", "their dives are not here"
        return
    for dive in ("auto_square", "gnss_challenging"):
        config = load_config(
            file=EXAMPLES / "blueye_x3.toml",
            overrides=["dvl.lever_arm_m=[0,0,0]", "dvl.latency_s=0"],
        )
        after = found_of(read_dive(DATA / f"blueye_x3/{dive}.mcap", config)).after
        off_m = np.max(np.abs(np.array(after.lever_arm_m) - [-0.17, 0.0, 0.26]))
        yield f"Blueye, {dive}: arm", "5 cm from the papers'", f"{100.0 * off_m:.1f} cm"
        yield f"Blueye, {dive}: delay", "0.10 to 0.16 s", f"{after.latency_s:.3f} s"
    for dive in ("run_1", "run_2"):
        config = load_config(
            file=EXAMPLES / "ufmil.toml", overrides=["dvl.mounting_rpy_deg=[0,0,0]"]
        )
        read = read_dive(DATA / f"ufmil/{dive}.mcap", config)
        after = found_of(read.with_config(with_mounting(config, likeliest_mounting([read])))).after
        yield (
            f"ufmil, {dive}: heading of the DVL",
            "3 deg from 90",
            f"{after.mounting_rpy_deg[2]:.1f} deg",
        )


def three_commands() -> Iterator[Line]:
    """`inspect --propose`, `calibrate`, `run`: what the replay says of its own innovations."""
    # Noise that dives contradict but do not determine is that of the class of the IMU, which may be too large.
    asked = "consistent or conservative"
    for name, typed in (
        ("blueye_x3/auto_square", ()),
        ("ufmil/run_1", ("--set", "initial.latitude_deg=29.65")),
    ):
        if (DATA / f"{name}.mcap").is_file():
            size, word = _replayed(DATA / f"{name}.mcap", typed)
            yield f"three commands, {name}: NIS / dof", asked, f"{size:.3f}, {word}"
    for grade in ("fog", "tactical", "mems"):
        for put_in in (
            (),
            ("--lever-arm", "0.3,-0.1,0.2", "--mounting", "0,0,1.5", "--dvl-delay", "0.12"),
        ):
            sizes, words = zip(
                *(_simulated(grade, seed, put_in) for seed in COMMAND_SEEDS), strict=True
            )
            built = "built in otherwise" if put_in else "as configured"
            yield (
                f"three commands, {len(words)} simulated dives, {grade}, {built}",
                asked,
                f"{words.count('consistent')} of {len(words)}; NIS / dof {min(sizes):.3f} to {max(sizes):.3f}",
            )


def _simulated(grade: str, seed: int, put_in: Sequence[str]) -> tuple[float, str]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "dive.mcap"
        _run(
            [
                "simulate",
                "calibration",
                "--imu",
                grade,
                "--seed",
                str(seed),
                "-o",
                str(log),
                *put_in,
            ]
        )
        return _replayed(log, ())


def _replayed(log: Path, typed: Sequence[str]) -> tuple[float, str]:
    with tempfile.TemporaryDirectory() as folder:
        first, second, out = (
            str(Path(folder) / name) for name in ("first.toml", "second.toml", "out")
        )
        _run(["inspect", str(log), "--propose", first])
        _run(["calibrate", str(log), "-c", first, "-o", second, *typed])
        _run(["run", str(log), "-c", first, "-c", second, "-o", out, "--starts", "1", *typed])
        report = json.loads((Path(out) / log.stem / "report.json").read_text("utf-8"))
    rows = report["tables"]["consistency"]
    (row,) = (
        row for row in rows if (row["filter"], row["measurement"]) == ("baseline", "velocity")
    )
    return row["mean_nis"] / row["dof"], row["verdict"]


def _run(command: list[str]) -> None:
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as said:
        code = run_command_line(command)
    if code:
        raise RuntimeError(f"{command}: {code}: {said.getvalue()}")


def times() -> Iterator[Line]:
    """Wall-clock time of `calibrate` without reading, all numbers at once."""
    dives = [built_in_otherwise("figure-eight", seed, DvlErrors()) for seed in range(6000, 6008)]
    for count, asked in ((1, "at most 4 s"), (8, "at most 30 s")):
        begin = time.perf_counter()
        found_of(*dives[:count])
        name = "one dive of 424 s" if count == 1 else f"{count} dives of 424 s"
        yield f"time, {name}", asked, f"{time.perf_counter() - begin:.1f} s"


PARTS: tuple[Callable[[], Iterator[Line]], ...] = (
    errors_over_sds,
    with_estimated_imu_errors,
    straight_lines,
    wild_pings,
    right_angles,
    snapir,
    real_vehicles,
    three_commands,
    times,
)


if __name__ == "__main__":
    main()
