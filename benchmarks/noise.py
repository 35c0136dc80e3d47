"""What adaptive and Student-t noise of the DVL cost on clean dives, and bring where pings are off, or noisier.

`make judge` runs this. Verdicts are over groups of dives.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from contaminated_dives import (
    BEAM_SD_MPS,
    CANDIDATES,
    SHARE,
    clean_dive,
    competitors,
    contaminated_dive,
    noisier_dive,
)
from judged import SIZES, Record, record_of, words_of_groups
from results import machine, table, write_part

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.tables import finite
from insdvl_replay.preparation.replay import replay_dive

DIVES = 8
LENGTH_S = 400.0
STARTS = 2
GROUPS = 60
SEED = 5
OFF_BY_MPS = (0.05, 0.2, 1.0)
TIMES = 3.0
WITH_POSITION = ("position",)
QUANTITIES = {
    "position x": "position",
    "velocity x": "velocity_across",
    "drift x": "drift_60s",
    "NIS x": "nis",
}


def worlds() -> Iterator[tuple[str, Callable[[int], Dive], Config, str]]:
    """Name the dives, make one by its seed, and say which filters are tried on them, and how they are aided."""
    for aiding in ("velocity", "beams"):
        yield "clean", lambda seed: clean_dive(seed, LENGTH_S), competitors(aiding, STARTS), aiding
    for off_by_mps in OFF_BY_MPS:
        made = partial(contaminated_dive, length_s=LENGTH_S, off_by_mps=off_by_mps)
        for aiding in ("velocity", "beams"):
            yield f"{off_by_mps:g} m/s off", made, competitors(aiding, STARTS), aiding
    made = partial(noisier_dive, length_s=LENGTH_S, times=TIMES)
    for aiding, states in (
        ("velocity", ()),
        ("beams", ()),
        ("velocity", WITH_POSITION),
        ("beams", WITH_POSITION),
    ):
        words = " + ".join([aiding, *states])
        yield f"noise x {TIMES:g}", made, competitors(aiding, STARTS, states), words


def rows() -> Iterator[tuple[str, ...]]:
    """Count the words on each candidate, world by world."""
    for world, made, config, aiding in worlds():
        replays = [replay_dive(made(seed), config) for seed in range(DIVES)]
        for name in CANDIDATES:
            records = [record_of(replay, name) for replay in replays]
            ratios = (f"{ratio(records, quantity):.3f}" for quantity in QUANTITIES.values())
            words = (
                words_of_groups(name, "baseline", records, size, GROUPS, SEED) for size in SIZES
            )
            yield world, aiding, name, *words, *ratios


def ratio(records: list[Record], quantity: str) -> float:
    """Return the median ratio of a quantity to the baseline's, whatever was said of it."""
    rows = (row for record in records for row in record.rows)
    return float(np.median([finite(row.ratio) for row in rows if row.quantity == quantity]))


def main() -> None:
    """Measure, print and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    about = (
        f"{DIVES} simulated lawnmowers of {LENGTH_S:.0f} s a row, with sensors that err as the filters are told "
        f"(beams {BEAM_SD_MPS:g} m/s). Then the beams of {100 * SHARE:g} % of the pings are off by so much (sd); then "
        f"all are {TIMES:g} times as noisy from the middle on. {GROUPS} groups of each size are drawn from the dives; "
        "words are in percent of them. On clean dives *equivalent* and *no effect* are right. With pings that are far "
        "off, NIS / dof of the baseline is above 10, and it is not evaluated. A filter drifts more the less it trusts "
        "the DVL, though its velocity is better. The last columns are median ratios of single dives: position, "
        f"velocity across, drift in 60 s, and how far NIS / dof is from 1. {machine()}."
    )
    columns = ("pings", "aiding", "noise", *(f"{size} dives" for size in SIZES), *QUANTITIES)
    part = "\n".join(
        ["# Noise", "", about, "", *table(columns, [f"| {' | '.join(row)} |" for row in rows()])]
    )
    write_part(part)
    sys.stdout.write(f"{part}\n")


if __name__ == "__main__":
    main()
