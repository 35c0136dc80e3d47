"""Signals that end a command: they raise KeyboardInterrupt, but never within an import, and never after the work.

A library may take an interrupt within its own import for a missing part, and go on without it or fail with another
error. Such an interrupt therefore waits until the import is done; a second one does not wait. Compiled code may drop
the exceptions of Python code that it calls. An interrupt is therefore raised again until it is on its way out.

This module needs next to nothing, so that signals are handled before all that takes time is imported.
"""

import signal
import sys

TYPE_CHECKING = False  # as in `typing`, whose import takes as long as all that is here
if TYPE_CHECKING:
    from types import FrameType

AGAIN_S = 0.02
"""After which an interrupt that waits, or was dropped, is raised."""
_IMPORTS = "<frozen importlib"


class _State:
    was_asked = False
    may_raise = False


def handle_signals() -> None:
    """Take note of SIGINT and SIGTERM from here on; they end `interruptible` work."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _asked)
    signal.signal(signal.SIGALRM, _asked_before)
    sys.unraisablehook = _dropped
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})


def was_interrupted() -> bool:
    """Return whether a signal has asked for the end, which another error may hide."""
    return _State.was_asked


class interruptible:  # noqa: N801  # a class, since `contextlib` takes a while to import
    """Work that a signal ends.

    Raises
    ------
    KeyboardInterrupt
        SIGINT or SIGTERM has come, also before the work began, which ends it at once.
    """

    def __enter__(self) -> None:
        _State.may_raise = True
        if _State.was_asked:
            raise KeyboardInterrupt

    def __exit__(self, *_: object) -> None:
        _State.may_raise = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _asked(_signal: int, frame: "FrameType | None") -> None:
    may_wait = not _State.was_asked
    _State.was_asked = True
    if not _State.may_raise:
        return
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
    if not (may_wait and _is_importing(frame)):
        raise KeyboardInterrupt


def _asked_before(_signal: int, frame: "FrameType | None") -> None:
    if _State.may_raise and not _is_importing(frame) and not _is_ending():
        raise KeyboardInterrupt


def _is_importing(frame: "FrameType | None") -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTS):
            return True
        frame = frame.f_back
    return False


def _is_ending() -> bool:
    """Return whether an interrupt is on its way out, and what runs is what is done before the end."""
    error = sys.exception()
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _dropped(what: "sys.UnraisableHookArgs") -> None:
    """Report an error that Python drops, as Python does; an interrupt is raised again instead."""
    if not issubclass(what.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(what)
