"""Replays before and after a change of settings, each side in a folder of its own, and their comparison."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace as with_values

from insdvl_replay.batch.fitted_noise import with_same_noise
from insdvl_replay.batch.found import Fetch, FoundDive
from insdvl_replay.batch.jobs import ReplayJob, ReplayOptions, plan_jobs
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import changed_by
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.settings_layers import SettingsLayers

if TYPE_CHECKING:
    # Needs scipy, and replays come first.
    from insdvl_replay.changes.comparison import Comparison

Configs = Mapping[Path | None, Config]
"""Settings by the file of a dive's own; those of dives without one are those of None."""


@dataclass(frozen=True)
class Side:
    """The replays before a change, or those after it."""

    folder: Path
    jobs: Sequence[ReplayJob]


@dataclass(frozen=True)
class BothSides:
    """The same dives before and after a change."""

    before: Side
    after: Side

    @property
    def jobs(self) -> list[ReplayJob]:
        """All replays, those before the change first."""
        return [*self.before.jobs, *self.after.jobs]


def require_change(before: Configs, after: Configs, change: str) -> None:
    """Raise a ConfigError, which names the change, if it has no effect on any dive."""
    if before == after:
        raise ConfigError(f"{change}: is the setting already", "give another value")
    deciding = []
    for file, config in before.items():
        if _is_unheeded(config, after[file]):
            deciding.append(config.dvl.beam_sd_mps)
    if len(deciding) == len(before):
        text = f"{change}: has no effect, since dvl.beam_sd_mps = {deciding[0]:g} decides"
        raise ConfigError(text, "change dvl.beam_sd_mps, or add --against dvl.beam_sd_mps=none")


def _is_unheeded(before: Config, after: Config) -> bool:
    """Return whether only a noise of the velocity changes, and one of the beams stands above it."""
    if before.dvl.beam_sd_mps is None:
        return False
    dvl = with_values(after.dvl, velocity_sd_mps=before.dvl.velocity_sd_mps)
    return with_values(after, dvl=dvl) == before


def plan_against(
    dives: Sequence[FoundDive],
    output: Path,
    options: ReplayOptions,  # before the change
    layers: SettingsLayers,  # likewise
    against: Sequence[str],  # ``section.key=value``, together one change
    fetch: Fetch,
    how: Replaying,
    *,
    one_dive: bool = False,
) -> BothSides:
    """Plan the replays of dives without and with a change of some keys."""
    files = {dive.settings for dive in dives}
    before = {file: layers.load(file) for file in files}
    after = {file: layers.load(file, against=against) for file in files}  # without a fitted noise
    require_change(before, after, f"--against {against[-1]}")

    def changed(_job: ReplayJob, fitted: Config) -> Config:
        return changed_by(fitted, against, allow_code=layers.allow_code)

    both = options, replace(options, config=after.get(None, options.config))
    configs = before, after
    fetched = fetch(dives)
    return plan_both_sides(fetched, output, both, configs, changed, how, one_dive=one_dive)


def plan_both_sides(
    dives: Sequence[FoundDive],
    output: Path,
    options: tuple[ReplayOptions, ReplayOptions],
    configs: tuple[Configs, Configs],
    changed: Callable[[ReplayJob, Config], Config],
    how: Replaying,
    *,
    one_dive: bool = False,
) -> BothSides:
    """Plan the replays of both sides, below the output; a noise that nobody has given is fitted before the change.

    Parameters
    ----------
    options : tuple of ReplayOptions
        Before and after, as `configs`, which are of dives with settings of their own.
    changed : callable
        Gives the settings of a job after the change, by those with a noise before it.
    """
    old = output / "before"
    new = output / "after"
    before = plan_jobs(dives, old, options[0], configs[0], one_dive=one_dive)
    after = plan_jobs(dives, new, options[1], configs[1], one_dive=one_dive)
    before, after = with_same_noise(before, after, changed, how)
    return BothSides(Side(old, before), Side(new, after))


def compare_sides(sides: BothSides, done: Sequence[str]) -> "Comparison | None":
    """Compare the dives of which both sides have been replayed, by the names of all replays that were done.

    Without any there is nothing to compare.
    """
    from insdvl_replay.changes.comparison import compare_results

    both = [name for name in dict.fromkeys(done) if done.count(name) > 1]
    if not both:
        return None
    return compare_results(sides.before.folder, sides.after.folder, dives=both)
