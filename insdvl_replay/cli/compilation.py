"""``insdvl-replay compile``."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from insdvl_replay.cli.messages import emit
from insdvl_replay.cli.options import Verbose
from insdvl_replay.core.plain_text import visible

_SHORT_S = 10.0


def compile_(verbose: Verbose = 0) -> None:
    """Compile the filter ahead of the first run, which else does it.

    The code is kept in ~/.cache/insdvl-replay, or where INSDVL_REPLAY_CACHE says. Runs with the same variable find it
    there, even where that folder cannot be written any more, as in a container.

    \b
    Example:
      insdvl-replay compile -v
      insdvl-replay compile
      INSDVL_REPLAY_CACHE=/opt/insdvl-replay insdvl-replay compile
    """
    from insdvl_replay.core.compiled import cache_folder, is_warm
    from insdvl_replay.core.errors import ConfigError

    folder, start_s = cache_folder(), time.perf_counter()
    if folder is None:
        raise ConfigError(
            "compiled code cannot be kept: its folder cannot be written, or others can write there, too",
            "INSDVL_REPLAY_CACHE=/a/folder/of/yours insdvl-replay compile",
        )
    was_warm = is_warm()
    with TemporaryDirectory() as name:
        _replay_something(Path(name) / "dive.mcap")
    took_s = time.perf_counter() - start_s
    emit(visible(f"was compiled already: {folder}" if was_warm else f"compiled in {took_s:.1f} s: {folder}") + "\n")


def _replay_something(log: Path) -> None:
    """Go through all that a run compiles."""
    from insdvl_replay.core.config import Config
    from insdvl_replay.logs import write_dive
    from insdvl_replay.replay import replay_log
    from insdvl_replay.sim.dive import simulate_dive

    write_dive(log, simulate_dive("straight", seed=1, duration_s=_SHORT_S))
    replay_log(log, Config())
