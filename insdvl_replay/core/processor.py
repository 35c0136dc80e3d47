"""One choice of machine code for all x86 processors with AVX2, so that the same dives give the same bytes on each.

numpy, OpenBLAS and LLVM choose code by the processor that they run on, and what they compute differs in the last bit.
Processors of the level x86-64-v3 (Intel from 2013, AMD from 2015) have all that the common choice needs. Others, and
other systems than Linux, compute with the code that the libraries choose.

The level is defined in the System V psABI for x86-64, section 3.1.1.
"""

import os
import re
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final

LEVEL: Final = "x86-64-v3"
# As Linux names them; it lists AVX and the others only where the system keeps their registers.
_NEEDED: Final = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
# What numpy would choose beyond AVX2, by the names that it has had since 2.4, and before.
_BEYOND: Final = "X86_V4 AVX512_ICL AVX512_SPR"
_BEYOND_BEFORE: Final = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"
_NEW_NAMES: Final = (2, 4)


@cache
def has_common_code(processors: Path = Path("/proc/cpuinfo")) -> bool:
    """Return whether this processor has all instructions of the level x86-64-v3, by what Linux says of it."""
    if sys.platform != "linux":
        return False
    try:
        with processors.open(encoding="utf-8", errors="replace") as lines:
            for line in lines:
                name, _, value = line.partition(":")
                if name.strip() == "flags":
                    return set(value.split()) >= _NEEDED
    except OSError:
        pass
    return False


def use_common_code() -> None:
    """Have numpy and OpenBLAS use the common code, in this process and those that it starts.

    It must be called before numpy is imported. What the user has set in the environment stays.
    """
    if not has_common_code():
        return
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
    os.environ.setdefault("NPY_DISABLE_CPU_FEATURES", _names_of_features())


def _names_of_features() -> str:
    """Return what numpy must not use, by the names that the installed version knows."""
    spec = find_spec("numpy")
    if spec is not None and spec.origin is not None:
        text = Path(spec.origin).with_name("version.py").read_text("utf-8")
        found = re.search(r'^version = "(\d+)\.(\d+)', text, re.MULTILINE)
        if found is not None and (int(found[1]), int(found[2])) < _NEW_NAMES:
            return _BEYOND_BEFORE
    return _BEYOND


def compile_common_code() -> None:
    """Have numba compile for the level, before its first function; what the user has set in the environment stays."""
    from numba.core import config

    if has_common_code() and not config.CPU_NAME:  # type: ignore[attr-defined]
        config.CPU_NAME = LEVEL  # type: ignore[attr-defined]
        config.CPU_FEATURES = ""  # type: ignore[attr-defined]
