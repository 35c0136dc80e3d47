"""Work that counts the threads of the process that does it."""

import threading

import psutil


def threads_with_numpy(_item: int) -> int:
    """Import numpy, which starts threads of its own unless it is told not to, and count, but for Python's that wait."""
    import numpy as np

    np.eye(500) @ np.eye(500)
    return psutil.Process().num_threads() - (threading.active_count() - 1)
