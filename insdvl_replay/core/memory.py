"""Memory that is free goes back to the system; what stays is not looked through again and again."""

import gc
import os
import resource
import sys
from pathlib import Path
from typing import Final

_MANY_OBJECTS: Final = 200_000
_LARGEST_LIBRARY: Final = 256 << 20
"""Address space that a library may ask for at once as it is loaded, and more."""


def collect_rarely() -> None:
    """Let Python look for objects that hold each other only after many new ones.

    The packages make some hundred thousand objects as they load, and all of them stay: to look through them at each
    thousandth would take a tenth of a short run.
    """
    gc.set_threshold(_MANY_OBJECTS)


def use_small_pages() -> None:
    """Keep numpy, which must not be loaded yet, from asking for huge pages, unless the user does.

    A virtual machine gives its large free pieces of memory back to its host, and waits long to have one again; small
    pages come from what it still has. Where memory is not shared so, the columns of an hour take milliseconds more.
    """
    os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")


def return_freed_memory() -> None:
    """Give back what was freed but is kept by the C library, some 80 MB after the reading of a long dive.

    glibc keeps freed blocks below others that are still in use; where there is no glibc, nothing is done.
    """
    if sys.platform == "linux":
        import ctypes  # not when the program starts, which needs none of it

        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def is_nearly_used_up() -> bool:
    """Say whether the limit of the address space, as `ulimit -v` sets it, has left too little to load a library.

    Then any failure may be one of memory: not all libraries say so.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return limit != resource.RLIM_INFINITY and limit - _most_mapped() < _LARGEST_LIBRARY


def _most_mapped() -> int:
    """Give the most bytes of address space that this process has had; 0 where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text("ascii").splitlines()
    except (OSError, UnicodeDecodeError):
        return 0
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmPeak:")), 0)
