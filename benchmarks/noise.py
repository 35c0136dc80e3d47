"""What adaptive and Student-t noise of the DVL cost on clean dives, and bring where pings are off, or noisier.

`make judge` runs this.
"""

import argparse
import sys
from collections import Counter
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
from results import machine, table, write_part

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.replay import Replay, replay_dive

DIVES, LENGTH_S, STARTS = 20, 600.0, 8
OFF_BY_MPS = (0.05, 0.2, 1.0)
TIMES = 3.0
WITH_POSITION = ("position",)
WORDS = ("better", "worse", "mixed", "equivalent", "undecided", "not evaluated")
DRIFT, NIS = "drift_60s", "nis"


def worlds() -> Iterator[tuple[str, Callable[[int], Dive], Config, str]]:
    """Name the dives, make one by its seed, and say which filters are tried on them, and how they are aided."""
    for aiding in ("velocity", "beams"):
        yield "clean", lambda seed: clean_dive(seed, LENGTH_S), competitors(aiding, STARTS), aiding
    for off_by_mps in OFF_BY_MPS:
        made = partial(contaminated_dive, length_s=LENGTH_S, off_by_mps=off_by_mps)
        for aiding in ("velocity", "beams"):
            yield f"{off_by_mps:g} m/s off", made, competitors(aiding, STARTS), aiding
    made = partial(noisier_dive, length_s=LENGTH_S, times=TIMES)
    for aiding, states in (("velocity", ()), ("beams", ()), ("velocity", WITH_POSITION), ("beams", WITH_POSITION)):
        words = " + ".join([aiding, *states])
        yield f"noise x {TIMES:g}", made, competitors(aiding, STARTS, states), words


def rows() -> Iterator[tuple[str, ...]]:
    """Count the words on each candidate, world by world."""
    for world, made, config, aiding in worlds():
        replays = [replay_dive(made(seed), config) for seed in range(DIVES)]
        for name in CANDIDATES:
            words = Counter(str(replay.verdicts[name].verdict) for replay in replays)
            ratios = (f"{ratio(replays, name, quantity):.3f}" for quantity in (DRIFT, NIS))
            yield world, aiding, name, *(str(words[word]) for word in WORDS), *ratios


def ratio(replays: list[Replay], name: str, quantity: str) -> float:
    """Return the median ratio of a quantity to the baseline's, whatever was said of it."""
    found = (row for replay in replays for row in replay.tables.evidence)
    return float(np.median([row.ratio for row in found if (row.filter, row.quantity) == (name, quantity)]))


def main() -> None:
    """Measure, print and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    about = (
        f"{DIVES} simulated lawnmowers of {LENGTH_S:.0f} s a row, with sensors that err as the filters are told "
        f"(beams {BEAM_SD_MPS:g} m/s). Then the beams of {100 * SHARE:g} % of the pings are off by so much (sd); then "
        f"all are {TIMES:g} times as noisy from the middle on. On clean dives *equivalent* is right, on contaminated "
        "ones *better*. A filter drifts more the less it trusts the DVL, though its velocity is better. With the "
        "position among its states it drifts by as much. The last columns are median ratios, of the drift in 60 s and "
        f"of how far NIS / dof is from 1. {machine()}."
    )
    columns = ("pings", "aiding", "noise", *WORDS, "drift x", "NIS x")
    part = "\n".join(["# Noise", "", about, "", *table(columns, [f"| {' | '.join(row)} |" for row in rows()])])
    write_part(part)
    sys.stdout.write(f"{part}\n")


if __name__ == "__main__":
    main()
