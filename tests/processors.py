"""Other processors, emulated: what numpy, OpenBLAS, numba and the C library choose by the processor, chosen by hand.

Usage: python tests/processors.py ARGUMENTS, which runs Python with them on each; `make processors` runs all tests so.
"""

import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

SSE = frozenset({"SSSE3", "SSE41", "POPCNT", "SSE42", "X86_V2"})
AVX = SSE | {"AVX"}
AVX2 = AVX | {"F16C", "FMA3", "AVX2", "X86_V3"}
WORK = Path(__file__).parent / "processor_work.py"


@dataclass(frozen=True)
class Processor:
    """A processor by the names that the libraries have for it.

    Attributes
    ----------
    openblas, numba : str
        Its core, and what LLVM calls it.
    features : frozenset of str
        Of what numpy chooses code by, that which it has.
    glibc : str
        What the C library has to do without.
    """

    openblas: str
    numba: str
    features: frozenset[str]
    glibc: str

    def environment(self) -> dict[str, str]:
        """Environment of a process on it. An empty list of features means those that numba's name stands for."""
        return os.environ | {
            "OPENBLAS_CORETYPE": self.openblas,
            "NPY_DISABLE_CPU_FEATURES": " ".join(sorted(self.switched_off())),
            "NUMBA_CPU_NAME": self.numba,
            "NUMBA_CPU_FEATURES": "",
            "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={self.glibc}",
        }

    def switched_off(self) -> set[str]:
        """What this numpy could choose, and must not; some of it may be off here already."""
        return set(__cpu_dispatch__) - self.features

    def blocker(self) -> str:
        """Say why it cannot be emulated here; nothing if it can."""
        if platform.machine() not in ("x86_64", "AMD64"):
            return f"cannot emulate x86 processors on {platform.machine()}"
        needed = self.features & {"AVX", "AVX2"}
        missing = sorted(name for name in needed if not __cpu_features__[name])
        return f"cannot emulate {', '.join(missing)}: this processor lacks it" if missing else ""

    def run(self, *commands: Sequence[str]) -> str:
        """Run command lines of the program on it, and give the digest of a motion that was computed there."""
        if blocker := self.blocker():
            pytest.skip(blocker)
        done = subprocess.run(
            [sys.executable, str(WORK), " ".join(self.switched_off())],
            env=self.environment(),
            input="\n".join(map(shlex.join, commands)),
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout


PROCESSORS = {
    "AVX2": Processor("Haswell", "haswell", AVX2, "-AVX512F,-AVX512VL"),
    "AVX2 of AMD": Processor("Zen", "znver2", AVX2, "-AVX512F,-AVX512VL"),
    "AVX": Processor("Sandybridge", "sandybridge", AVX, "-AVX512F,-AVX512VL,-AVX2,-FMA"),
    "SSE": Processor("Prescott", "generic", frozenset(), "-AVX512F,-AVX512VL,-AVX2,-FMA,-AVX"),
}
"""From 2013, from 2019, from 2011, and the least that the programs in Python's packages are made for."""


if __name__ == "__main__":
    for name, processor in PROCESSORS.items():
        blocker = processor.blocker()
        sys.stdout.write(f"--- {name} {blocker}\n")
        sys.stdout.flush()
        if not blocker:
            subprocess.run(
                [sys.executable, *sys.argv[1:]], env=processor.environment(), check=True
            )
