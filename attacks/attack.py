"""Attack the program with damaged logs, bombs, hostile names, kills and logs that change while they are read.

`make attack` runs all of it and writes the tables of benchmarks/RESULTS.md. Exit code 1 says that a defect was found;
each is one line on stdout, with the seed that makes it again.
"""

import argparse
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported; each attacker has one core

ROOT = Path(__file__).resolve().parents[1]
sys.path[1:1] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from insdvl_replay.memory import collect_rarely, use_small_pages  # noqa: E402

COLUMNS = ("", "raw", "raw, no checksums", "fixed", "fixed, no checksums")


def mutate(arguments: argparse.Namespace) -> bool:
    """Damage logs by the thousand."""
    from base_logs import all_logs, short_logs
    from mutate import campaign, rows
    from results import machine, table, write_part
    from victim import BEYOND_MB, DEFECTS, LIMIT_S

    count = arguments.count or 10_000
    seeds = range(arguments.seed, arguments.seed + count)
    with TemporaryDirectory() as name:
        folder = Path(name)
        bases = (short_logs if arguments.short else all_logs)(folder / "bases")
        outcomes = campaign(bases, seeds, arguments.jobs, folder, arguments.keep)
    lines = [
        "# Attack: damaged logs",
        "",
        f"{count} mutants of {len(bases)} logs, from seed {arguments.seed}; each replayed with and without "
        f"`--allow-damaged`, a third inspected with `--deep`. *raw*: bytes damaged in place. *fixed*: content changed, "
        f"with all lengths, offsets and checksums right. A hang takes {LIMIT_S} s, memory {BEYOND_MB:.0f} MB more than "
        "the clean log.",
        "",
        *table(COLUMNS, rows(outcomes)),
        "",
        f"{machine()}. The first {len(DEFECTS)} classes are defects.",
    ]
    part = "\n".join(lines) + "\n"
    sys.stdout.write(part)
    if arguments.write:
        write_part(part)
    return any(outcome.verdict in DEFECTS for outcome in outcomes)


ATTACKS = {"mutate": mutate}


def main() -> None:
    """Run one attack or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("attack", choices=[*ATTACKS, "all"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, help="how many; each attack has its own number")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--short", action="store_true", help="damage only short logs")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the mutants that show defects")
    parser.add_argument("--write", action="store_true", help="write the table to benchmarks/RESULTS.md")
    arguments = parser.parse_args()
    collect_rarely()
    use_small_pages()
    chosen = ATTACKS if arguments.attack == "all" else [arguments.attack]
    sys.exit(int(any([ATTACKS[name](arguments) for name in chosen])))


if __name__ == "__main__":
    main()
