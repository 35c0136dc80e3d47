"""How often a baseline whose noise is far off is named, where innovations do not show it, and how often a sound one.

`python benchmarks/misfit_worlds.py` writes the part of the page of results. Sensors err as in the worlds of `worlds`;
the baseline is told some of the noise of their preset times a factor. Its reference is independent, and filters are
told how noisy it is. A copy of the baseline is the candidate, so that the tool says *no effect* or *not evaluated*.
"""

import math
import time
from collections.abc import Sequence
from statistics import median
from typing import Final, NamedTuple

import msgspec
from judged import record_of
from results import finish, judging_parser, machine, table, worker_processes
from worlds import WORLDS, dive_seed, made_dive

from insdvl_replay.core.config import Config, InertialNoise
from insdvl_replay.core.quantities import SETTLED
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Verdict
from insdvl_replay.preparation.replay import replay_dive

DIVES: Final = 24
ALLOWED_ERRORS: Final = 3.0
MOST_SOUND_PCT: Final = 2.0
LEAST_MISFIT_PCT: Final = 60.0
STARTS: Final = 1
GYROS: Final = ("gyro_white_rad_rts", "gyro_bias_walk_radps_rts")
ACCELEROMETERS: Final = ("accel_white_mps_rts", "accel_bias_walk_mps2_rts")
ALL: Final = InertialNoise.__struct_fields__
EXACT: Final = {"position_sd_m": 1e-3, "velocity_sd_mps": 1e-4, "attitude_sd_deg": 1e-3}
"""Of the reference in worlds whose reference is exact; nobody says so where it is 0."""


class Misfit(NamedTuple):
    """A baseline that is told another noise than the sensors have."""

    world: str
    about: str
    noises: tuple[str, ...] = ()
    times: float = 1.0
    """Standard deviations, as told."""
    is_asked: bool = False
    """Whether it has to be named."""

    @property
    def is_sound(self) -> bool:
        """Whether it must not be named."""
        return not self.noises


TACTICAL: Final = "tactical sensors as the preset says"
FOG: Final = "FOG sensors as the preset says"
LOST: Final = "sea: MEMS, the bottom lost now and then, 900 s"
WAVES: Final = "sea: MEMS in waves, 200 s"
HOVER: Final = "sea: hover, tactical, 400 s"
SWELL: Final = "sea: tactical in swell, a noisy reference of 1 Hz, 600 s"
STAY: Final = "sea: FOG, a DVL whose errors stay, 600 s"

MISFITS: Final = (
    *(Misfit(world, "sound") for world in (TACTICAL, FOG, LOST, WAVES, HOVER, SWELL, STAY)),
    Misfit(TACTICAL, "gyros, 30 times too small", GYROS, 1.0 / 30.0, is_asked=True),
    Misfit(TACTICAL, "accelerometers, 10 times too small", ACCELEROMETERS, 0.1, is_asked=True),
    Misfit(TACTICAL, "all, 7 times too small", ALL, 1.0 / 7.0, is_asked=True),
    Misfit(TACTICAL, "all, 7 times too large", ALL, 7.0),
    Misfit(FOG, "accelerometers, 10 times too small", ACCELEROMETERS, 0.1, is_asked=True),
    Misfit(FOG, "accelerometers, 10 times too large", ACCELEROMETERS, 10.0),
    Misfit(FOG, "all, 7 times too large", ALL, 7.0),
    Misfit(LOST, "gyros, 30 times too small", GYROS, 1.0 / 30.0, is_asked=True),
    Misfit(LOST, "all, 7 times too small", ALL, 1.0 / 7.0, is_asked=True),
    Misfit(WAVES, "gyros, 30 times too large", GYROS, 30.0),
    Misfit(SWELL, "all, 20 times too small", ALL, 0.05),
)


class Named(NamedTuple):
    """What the tool says of a baseline on one dive."""

    nis: float
    """Over its degrees of freedom."""
    nees: tuple[float, ...]
    """The same of velocity and level; NaN where there is none."""
    is_named: bool
    by_errors: bool


def config_of(misfit: Misfit, config: Config) -> Config:
    """Tell the baseline, and a copy of it, another noise."""
    noise = config.noise
    told = {key: misfit.times * getattr(noise, key) for key in misfit.noises}
    baseline = msgspec.structs.replace(config.filters[config.baseline], **told)
    reference = config.reference
    if not reference.attitude_sd_deg:
        reference = msgspec.structs.replace(reference, **EXACT)
    evaluation = msgspec.structs.replace(config.evaluation, starts=STARTS)
    filters = {config.baseline: baseline, "copy": baseline}
    return msgspec.structs.replace(
        config, filters=filters, reference=reference, evaluation=evaluation
    )


def named_on(place: int, number: int) -> Named:
    """Replay one dive."""
    misfit = MISFITS[place]
    (world,) = (row for row, world in enumerate(WORLDS) if world.name == misfit.world)
    config = config_of(misfit, WORLDS[world].config)
    reported, _ = made_dive(world, dive_seed(world, number))
    replay = replay_dive(reported, config)
    record = record_of(replay, "copy")
    sizes = {
        row.quantity: finite(row.mean_nees) / row.dof
        for row in replay.tables.credibility
        if row.quantity in SETTLED
    }
    return Named(
        nis=record.nis_per_dof,
        nees=tuple(sizes.get(quantity, math.nan) for quantity in SETTLED),
        is_named=record.word == Verdict.NOT_EVALUATED and "--control fits it" in record.reason,
        by_errors="NEES" in record.reason,
    )


class Row(NamedTuple):
    """A row of the table, and whether it is as it must be."""

    text: str
    is_met: bool


def row_of(misfit: Misfit, found: Sequence[Named]) -> Row:
    """Count how often a baseline is named."""
    dives = len(found)
    named = sum(one.is_named for one in found)
    by_errors = sum(one.is_named and one.by_errors for one in found)
    asked = ""
    is_met = True
    pct = 100.0 * named / dives
    if misfit.is_sound:
        asked = f"at most {MOST_SOUND_PCT:g}"
        is_met = pct <= MOST_SOUND_PCT + chance_pct(MOST_SOUND_PCT, dives)
    elif misfit.is_asked:
        asked = f"at least {LEAST_MISFIT_PCT:g}"
        is_met = pct >= LEAST_MISFIT_PCT - chance_pct(LEAST_MISFIT_PCT, dives)
    sizes = [f"{median(one.nis for one in found):.2g}"]
    for place in range(len(SETTLED)):
        sizes.append(f"{median(one.nees[place] for one in found):.2g}")
    mark = "" if is_met else " *"
    cells = (misfit.world, misfit.about, *sizes, f"{by_errors}", f"{named} of {dives}{mark}")
    return Row(f"| {' | '.join(cells)} | {asked} |", is_met)


def chance_pct(asked_pct: float, dives: int) -> float:
    """Return by how much a rate of so many dives may be off by chance."""
    share = asked_pct / 100.0
    return ALLOWED_ERRORS * 100.0 * math.sqrt(share * (1.0 - share) / dives)


ABOUT: Final = (
    "A baseline is told the standard deviations of its preset times a factor, where its innovations may not show it, "
    "and the reference is independent. How often the tool says that it is to be fitted first, and how often because "
    "of its errors (NEES). Sizes are medians over the dives, over the degrees of freedom; 1 is expected."
)


def main() -> None:
    """Judge, print and write the page; exit with 1 if a rate is not as it must be."""
    parser = judging_parser(__doc__)
    parser.add_argument("--dives", type=int, default=DIVES, help="of each row")
    given = parser.parse_args()
    begun_s = time.monotonic()
    places = [place for place in range(len(MISFITS)) for _ in range(given.dives)]
    numbers = [number for _ in MISFITS for number in range(given.dives)]
    with worker_processes(given.jobs) as processes:
        found = list(processes.map(named_on, places, numbers, chunksize=given.dives))
    rows = []
    for place, misfit in enumerate(MISFITS):
        of_row = found[place * given.dives : (place + 1) * given.dives]
        rows.append(row_of(misfit, of_row))
    columns = (
        *("world", "noise as told", "NIS", "NEES of velocity", "NEES of level"),
        *("named by NEES", "named", "asked [%]"),
    )
    took_s = time.monotonic() - begun_s
    lines = [
        "# Judgement: misfit baselines",
        "",
        ABOUT,
        "",
        *table(columns, [row.text for row in rows]),
    ]
    part = "\n".join([*lines, "", f"{machine()}; {took_s:.0f} s."])
    finish(part, is_whole=not given.print, all_met=all(row.is_met for row in rows))


if __name__ == "__main__":
    main()
