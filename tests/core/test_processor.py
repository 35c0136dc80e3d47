"""All processors with AVX2 use the same machine code, unless the user chooses another; others are left alone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from insdvl_replay.core.processor import LEVEL, has_common_code

HASWELL = "fpu sse sse2 ssse3 fma movbe popcnt avx f16c abm bmi1 avx2 bmi2"
CHOSEN = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
ASK = """
from insdvl_replay.core.processor import use_common_code
use_common_code()
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
import insdvl_replay.nav.filter
import numba.core.config
beyond = [name for name in __cpu_dispatch__ if "512" in name or name == "X86_V4"]
print(numba.core.config.CPU_NAME, any(__cpu_features__[name] for name in beyond))
"""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f"processor : 0\nflags\t\t: {HASWELL}\nbugs : none\n", True),
        (f"flags : {HASWELL} avx512f avx512vl\n", True),
        (f"flags : {HASWELL.replace(' fma', '')}\n", False),
        (f"flags : {HASWELL.replace(' avx2', '')}\n", False),
        ("Features : fp asimd evtstrm\n", False),
        ("", False),
    ],
)
def test_a_processor_has_the_common_code_by_what_linux_says(
    text: str, expected: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processors = tmp_path / "cpuinfo"
    processors.write_text(text, "utf-8")
    monkeypatch.setattr(sys, "platform", "linux")
    assert has_common_code(processors) == expected
    assert not has_common_code(tmp_path / "missing")


def test_other_systems_choose_by_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processors = tmp_path / "cpuinfo"
    processors.write_text(f"flags : {HASWELL}\n", "utf-8")
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not has_common_code(processors)


def chosen(**environment: str) -> str:
    """Return for which processor numba compiles in a new process, and whether numpy uses AVX-512."""
    kept = {name: value for name, value in os.environ.items() if name not in CHOSEN}
    asked = subprocess.run(
        [sys.executable, "-W", "error", "-c", ASK],
        env=kept | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return asked.stdout.strip()


@pytest.mark.skipif(not has_common_code(), reason="this processor has no AVX2")
def test_libraries_use_the_common_code_or_what_the_user_chose() -> None:
    assert chosen() == f"{LEVEL} False"
    assert chosen(NUMBA_CPU_NAME="haswell").startswith("haswell ")
