"""What adaptive and Student-t noise of the DVL cost on clean dives, and bring where a twentieth of the pings is off.

`make judge` runs this. IMU and DVL err as the filters are told. On clean dives *equivalent* is right, on the others
*better*.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterator

import numpy as np
from contaminated_dives import BEAM_SD_MPS, CANDIDATES, competitors, contaminated_dive
from results import machine, table, write_part

from insdvl_replay.replay import Replay, replay_dive

DIVES, LENGTH_S, STARTS = 20, 600.0, 8
OFF_BY_MPS = (0.0, 0.05, 0.2, 1.0)
AIDINGS = ("velocity", "beams")
WORDS = ("better", "worse", "mixed", "equivalent", "undecided", "not judged")
DRIFT, NIS = "drift_60s", "nis"


def rows() -> Iterator[tuple[str, ...]]:
    """Count the words on each candidate, by how far off pings are and what of them is used."""
    for off_by_mps in OFF_BY_MPS:
        for aiding in AIDINGS:
            config = competitors(aiding, STARTS)
            dives = (contaminated_dive(seed, LENGTH_S, off_by_mps) for seed in range(DIVES))
            replays = [replay_dive(dive, config) for dive in dives]
            for name in CANDIDATES:
                words = Counter(str(replay.verdicts[name].improvement) for replay in replays)
                ratios = (f"{ratio(replays, name, quantity):.3f}" for quantity in (DRIFT, NIS))
                size = f"{off_by_mps:g}" if off_by_mps else "clean"
                yield size, aiding, name, *(str(words[word]) for word in WORDS), *ratios


def ratio(replays: list[Replay], name: str, quantity: str) -> float:
    """Return the median ratio of a quantity to the baseline's, whatever was said of it."""
    found = (row for replay in replays for row in replay.tables.evidence)
    return float(np.median([row.ratio for row in found if (row.filter, row.quantity) == (name, quantity)]))


def main() -> None:
    """Measure, print and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    about = (
        f"{DIVES} simulated lawnmowers of {LENGTH_S:.0f} s a row, with sensors that err as the filters are told "
        f"(beams {BEAM_SD_MPS:g} m/s) but for 5 % of the pings, whose beams are off by so many m/s (sd). On clean "
        "dives *equivalent* is right, on the others *better*; the last columns are the median ratios of the drift in "
        f"60 s and of the NIS's distance from what it should be. {machine()}."
    )
    columns = ("off by", "aiding", "noise", *WORDS, "drift x", "NIS x")
    part = "\n".join(["# Noise", "", about, "", *table(columns, [f"| {' | '.join(row)} |" for row in rows()])])
    write_part(part)
    sys.stdout.write(f"{part}\n")


if __name__ == "__main__":
    main()
