"""A sample of damaged logs; `make attack` tries thousands, and bombs, names, kills and swaps beside them."""

import subprocess
import sys
from pathlib import Path

import pytest

ATTACK = Path(__file__).parents[1] / "attacks" / "attack.py"
MUTANTS = 200


def attacked(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Attack in a process of its own, which forks."""
    return subprocess.run([sys.executable, str(ATTACK), *arguments], capture_output=True, text=True)


def row(name: str, printed: str) -> list[int]:
    """Read the numbers of a row of the table."""
    line = next(line for line in printed.splitlines() if line.startswith(f"| {name} |"))
    return [int(cell) for cell in line.strip("| ").split("|")[1:]]


@pytest.mark.slow
def test_damaged_logs_end_in_a_sentence_or_in_tables_that_say_what_is_lost() -> None:
    found = attacked("mutate", "--short", "--seed", "1000", "--count", str(MUTANTS), "--jobs", "1")
    assert found.returncode == 0, found.stdout + found.stderr
    assert sum(row("mutants", found.stdout)) == MUTANTS
    assert all(number > 10 for number in row("runs", found.stdout))
    assert sum(row("differs, noted", found.stdout)) > 10  # the sample reaches tables, not only refusals


@pytest.mark.slow
def test_an_attack_fails_where_there_is_a_defect(tmp_path: Path) -> None:
    """The program is replaced by one that raises: every run of the sample is then a defect."""
    broken = tmp_path / "sitecustomize.py"
    broken.write_text(
        "import insdvl_replay.cli as cli\n"
        "run = cli.run_command_line\n"
        "def broken(arguments):\n"
        "    if 'clean_' in str(arguments) or 'bases' in str(arguments) or 'warm_' in str(arguments):\n"
        "        return run(arguments)\n"
        "    raise RuntimeError('a mistake')\n"
        "cli.run_command_line = broken\n"
    )
    command = [sys.executable, str(ATTACK), "mutate", "--short", "--count", "3", "--jobs", "1"]
    environment = {"PYTHONPATH": f"{tmp_path}:{ATTACK.parents[1]}", "HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    found = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert found.returncode == 1, found.stderr
    assert sum(row("traceback", found.stdout)) == sum(row("runs", found.stdout)) > 3
