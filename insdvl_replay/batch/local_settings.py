"""Settings next to dives: a file of one name, in the folder of a dive or above it, is used without being named.

It is looked for in the folder in which a log is named, with its links followed, and upwards to the root; the nearest
one counts. It is data, as a log is: code that it names never runs, whatever the options are.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from insdvl_replay.batch.found import FoundDive
from insdvl_replay.core.errors import counted
from insdvl_replay.core.settings_layers import LOCAL_SETTINGS, SettingsLayers


def with_local_settings(
    dives: Sequence[FoundDive],
    layers: SettingsLayers,
    *,
    is_wanted: bool = True,
) -> list[FoundDive]:
    """Give each local dive the settings in its folder or above; not where the layers name some files.

    What a manifest says of a dive stays.
    """
    if layers.files or layers.ready is not None or not is_wanted:
        return list(dives)
    known: dict[Path, Path | None] = {}
    found = []
    for dive in dives:
        if dive.settings is None and not dive.url:
            folder = _folder_of(dive)
            if folder not in known:
                known[folder] = _nearest(folder)
            dive = replace(dive, settings=known[folder])
        found.append(dive)
    return found


def place_of_settings(dive: FoundDive) -> str:
    """Return where the local settings of a dive are, seen from its folder; empty if there are none."""
    if dive.settings is None or dive.settings.name != LOCAL_SETTINGS or dive.url:
        return ""
    return os.path.relpath(dive.settings, _folder_of(dive))


def settings_sentences(dives: Sequence[FoundDive]) -> list[str]:
    """Return a sentence on each file that is used without being named, and on dives without one if others have some."""
    counts = dict[Path, int]()
    for dive in dives:
        if dive.settings is not None and place_of_settings(dive):
            counts[dive.settings] = counts.get(dive.settings, 0) + 1
    sentences = []
    for file, count in counts.items():
        whose = ""
        if count < len(dives):
            whose = f" of {counted(count, 'dive')}"
        sentences.append(f"settings{whose}: {as_typed(file)}")
    others = len(dives) - sum(counts.values())
    if sentences and others:
        sentences.append(f"{counted(others, 'dive')} without {LOCAL_SETTINGS}")
    return sentences


def _folder_of(dive: FoundDive) -> Path:
    """Return the folder of a dive as it is named; that of a bag or of tables is the dive itself."""
    path = dive.path
    if not path.is_dir():
        path = path.parent
    return Path(os.path.realpath(path))


def _nearest(folder: Path) -> Path | None:
    """Return the file in a folder or the nearest one above it; also a link that leads nowhere, which is an error."""
    for place in (folder, *folder.parents):
        file = place / LOCAL_SETTINGS
        if os.path.lexists(file):
            return file
    return None


def as_typed(file: Path) -> str:
    """Return a path as it would be typed here."""
    here = Path.cwd()
    if file.is_relative_to(here):
        return str(file.relative_to(here))
    return str(file)
