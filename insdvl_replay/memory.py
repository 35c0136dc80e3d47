"""Memory that is free goes back to the system."""

import ctypes
import sys


def return_freed_memory() -> None:
    """Give back what was freed but is kept by the C library, some 80 MB after the reading of a long dive.

    glibc keeps freed blocks below others that are still in use; where there is no glibc, nothing is done.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
