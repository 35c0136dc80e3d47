"""Attack the program with damaged logs and tables, bombs, hostile names, kills, and logs that change meanwhile.

`make attack` runs all of it and writes the tables of benchmarks/RESULTS.md. Exit code 1 says that a defect was found;
each is one line on stdout, with the seed that makes it again.
"""

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported; each attacker has one core

ROOT = Path(__file__).resolve().parents[2]
sys.path[1:1] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from results import machine, table, write_part  # noqa: E402

from insdvl_replay.core.runtime import prepare_process  # noqa: E402

MUTANTS = 10_000
TABLES = 1_000
FILES = 200
KILLS = 120
SWAPS = 60
TIDY = ("ok", "hidden folder left", "ended by the bare signal")
"""How a command may end that was killed or has to do with something hostile: the last two nobody can help."""


def _told(arguments: argparse.Namespace, title: str, text: str, lines: list[str]) -> None:
    """Print a part of the page, and write it if that is wanted."""
    part = "\n".join([f"# Attack: {title}", "", text, "", *lines, "", f"{machine()}."]) + "\n"
    sys.stdout.write(part)
    if arguments.write:
        write_part(part)


def _counted(outcomes: Iterable[tuple[str, str, str]]) -> tuple[list[str], bool]:
    """Count verdicts by what was done; say each defect. Outcomes are what was done, the verdict and what was seen."""
    counts: dict[str, Counter[str]] = {}
    for what, verdict, seen in outcomes:
        counts.setdefault(what, Counter())[verdict] += 1
        if verdict not in TIDY:
            sys.stdout.write(f"{verdict}: {seen!r}\n")
            sys.stdout.flush()
    rows = [
        f"| {what} | {found.total()} | {', '.join(f'{number} {name}' for name, number in found.most_common())} |"
        for what, found in sorted(counts.items())
    ]
    failed = any(verdict not in TIDY for found in counts.values() for verdict in found)
    return table(("what", "tried", "ended"), rows), failed


def mutate(arguments: argparse.Namespace, folder: Path) -> bool:
    """Damage logs by the thousand."""
    from base_logs import all_logs, recorded_logs, short_logs
    from mutate import COLUMNS, campaign, rows
    from victim import BEYOND_MB, DEFECTS, LIMIT_S

    count = arguments.count or MUTANTS
    seeds = range(arguments.seed, arguments.seed + count)
    made_by = recorded_logs if arguments.recorded else short_logs if arguments.short else all_logs
    bases = made_by(folder / "bases")
    bases = [base for base in bases if arguments.only in base.path.name]
    outcomes = campaign(bases, seeds, arguments.jobs, folder, arguments.keep)
    text = (
        f"{count} mutants of {len(bases)} logs, from seed {arguments.seed}; each replayed with and without "
        "`--allow-damaged`, a third inspected with `--deep`. *raw*: bytes damaged in place. *fixed*: content changed, "
        f"with all lengths, offsets and checksums right. A hang takes {LIMIT_S} s of processor time, memory "
        f"{BEYOND_MB:.0f} MB more than the clean log. The first {len(DEFECTS)} classes are defects."
    )
    _told(arguments, "damaged logs", text, table(COLUMNS, rows(outcomes)))
    return any(outcome.verdict in DEFECTS for outcome in outcomes)


def tables(arguments: argparse.Namespace, folder: Path) -> bool:
    """Damage tables by the hundred."""
    import tables as attacker
    from table_harm import ENDINGS
    from victim import BEYOND_MB, DEFECTS, LIMIT_S

    seeds = range(arguments.seed, arguments.seed + (arguments.count or TABLES))
    outcomes = list(attacker.campaign(seeds, arguments.jobs, folder))
    text = (
        f"{len(seeds)} mutants of a dive as tables, from seed {arguments.seed}: columns, text and bytes are changed. A "
        f"hang takes {LIMIT_S} s of processor time, memory {BEYOND_MB:.0f} MB more than the clean tables. The first "
        f"{len(DEFECTS)} classes are defects."
    )
    _told(arguments, "damaged tables", text, table(("", *ENDINGS), attacker.rows(outcomes)))
    return any(outcome.verdict in DEFECTS for outcome in outcomes)


def formats(arguments: argparse.Namespace, folder: Path) -> bool:
    """Damage files of instruments by the hundred."""
    import formats as attacker
    from victim import BEYOND_MB, DEFECTS, LIMIT_S

    seeds = range(arguments.seed, arguments.seed + (arguments.count or FILES))
    found = list(attacker.campaign(seeds, arguments.only, arguments.jobs, folder))
    columns, lines = attacker.rows(found)
    text = (
        f"{len(seeds)} mutants of a file of each format, from seed {arguments.seed}, each read with and without "
        "`--allow-damaged`, and every tenth replayed and inspected. A hang takes "
        f"{LIMIT_S} s of processor time, memory {BEYOND_MB:.0f} MB more than the clean file. The first "
        f"{len(DEFECTS)} classes are defects."
    )
    _told(arguments, "damaged files of instruments", text, table(columns, lines))
    return any(outcome.verdict in DEFECTS for outcome in found)


def _clean(folder: Path) -> tuple[bytes, float]:
    """Make a short dive and load all that its commands need; give its bytes and the memory it takes."""
    from base_logs import short_logs
    from mutate import prepared

    base = short_logs(folder / "bases")[0]
    clean = prepared([base], folder)[0]
    return base.path.read_bytes(), clean.peak_mb


def bombs(arguments: argparse.Namespace, folder: Path) -> bool:
    """Read small files that ask for much."""
    import bombs as attacker
    from victim import BEYOND_MB, LIMIT_S

    _, clean_mb = _clean(folder)
    rows: dict[str, list[str]] = {}
    failed = False
    for name, command, verdict, ended, size in attacker.attack(folder, clean_mb, arguments.only):
        failed |= verdict != "ok"
        rows.setdefault(name, [f"{size / 1e3:.0f}"]).append(
            f"{verdict}, {ended.peak_mb - clean_mb:.0f} MB"
        )
        if verdict != "ok":
            sys.stdout.write(
                f"{verdict}: {name}, {command}: {ended.peak_mb:.0f} MB, {ended.said[-300:].rstrip()}\n"
            )
            sys.stdout.flush()
    text = f"What takes {LIMIT_S} s of processor time, or {BEYOND_MB:.0f} MB more than a clean log, is a defect."
    columns = ("bomb", "kB", "`run`", "`run --allow-damaged`", "`inspect`")
    _told(
        arguments,
        "bombs",
        text,
        table(columns, [f"| {' | '.join([name, *cells])} |" for name, cells in rows.items()]),
    )
    return failed


def names(arguments: argparse.Namespace, folder: Path) -> bool:
    """Read logs with names that mean something elsewhere."""
    import hostile_names

    found = hostile_names.attack(folder, *_clean(folder), arguments.only)
    outcomes = (
        (
            f"{what.partition(' ')[0]}, `{command}`",
            verdict,
            f"{what}, {command}: {ended.said[-200:]!r}",
        )
        for what, command, verdict, ended in found
    )
    lines, failed = _counted(outcomes)
    text = "Nothing appears but results where they belong, no control characters, and no line that a build obeys."
    _told(arguments, "names", text, lines)
    return failed


def surroundings(arguments: argparse.Namespace, folder: Path) -> bool:
    """Put code, devices, pipes, links and other runs where a command meets them."""
    import surroundings as attacker

    content, _ = _clean(folder)
    lines, failed = _counted(
        found for found in attacker.attack(folder, content) if arguments.only in found[0]
    )
    text = "Each ends with the exit code and the sentence that it should, in a time that goes with its size."
    _told(arguments, "surroundings", text, lines)
    return failed


def kills(arguments: argparse.Namespace, folder: Path) -> bool:
    """Send signals at random moments."""
    import kills as attacker

    found = attacker.attack(
        folder / "archive", range(arguments.seed, arguments.seed + (arguments.count or KILLS))
    )
    lines, failed = _counted(
        (f"`{command}`, {signal}", verdict, seen) for command, signal, verdict, seen in found
    )
    text = (
        "Nothing is half written, no process lives on for 5 s, the next run succeeds. A hidden folder is left where "
        "nobody could clean up; the bare signal ends Python before or after the program."
    )
    _told(arguments, "kills", text, lines)
    return failed


def swaps(arguments: argparse.Namespace, folder: Path) -> bool:
    """Change logs while they are read."""
    import swaps as attacker

    found = attacker.attack(
        folder / "swaps", range(arguments.seed, arguments.seed + (arguments.count or SWAPS))
    )
    lines, failed = _counted(found)
    _told(
        arguments,
        "logs that change",
        "What a result says of its log is so, or there is no result.",
        lines,
    )
    return failed


ATTACKS = {
    "names": names,
    "surroundings": surroundings,
    "kills": kills,
    "swaps": swaps,
    "bombs": bombs,
    "mutate": mutate,
    "tables": tables,
    "formats": formats,
}


def _attacked(name: str, arguments: argparse.Namespace) -> bool:
    with TemporaryDirectory() as folder:
        return ATTACKS[name](arguments, Path(folder))


def main() -> None:
    """Run one attack or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("attack", choices=[*ATTACKS, "all"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, help="how many; each attack has its own number")
    parser.add_argument(
        "--only",
        default="",
        metavar="TEXT",
        help="logs, bombs and names whose name has this in it",
    )
    parser.add_argument("--jobs", type=int, default=2, help="of mutate, tables and formats")
    parser.add_argument("--short", action="store_true", help="damage only short logs")
    parser.add_argument(
        "--recorded", action="store_true", help="damage only the logs of ROS 1 in ../shared"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="keep the mutants that show defects"
    )
    parser.add_argument(
        "--write", action="store_true", help="write the tables to benchmarks/RESULTS.md"
    )
    arguments = parser.parse_args()
    prepare_process()
    chosen = list(ATTACKS) if arguments.attack == "all" else [arguments.attack]
    failed = [name for name in chosen if _attacked(name, arguments)]
    sys.exit(int(bool(failed)))


if __name__ == "__main__":
    main()
