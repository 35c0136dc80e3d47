"""The public dives, and where their logs are: on this machine, in the cache, or on their servers."""

import hashlib
import os
import shutil
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from written import PROJECT

from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.manifest import fetch_dives, manifest_dives
from insdvl_replay.core.dive_record import LOG_SUFFIXES
from insdvl_replay.core.errors import ConfigError, LogError, UserError, listed

NOWHERE = LogError("its log is not published in this form")
DATA = "DATA"  # variable of the environment: a folder with logs that need not be fetched


def data_folder() -> Path:
    """Return the folder with logs that need not be fetched."""
    return Path(os.environ.get(DATA) or PROJECT.parent / "shared" / "data")


@dataclass(frozen=True)
class Place:
    """The folders of a benchmark."""

    public: Path = PROJECT / "benchmarks" / "public"  # dives.toml, settings and candidates
    build: Path = PROJECT / "build" / "benchmark"
    data: Path = field(default_factory=data_folder)  # logs that need not be fetched
    candidates: str = "*"  # pattern of their names

    @property
    def dives(self) -> list[dict[str, Any]]:
        """The entries of dives.toml; the first tag of a dive is its data set, the second its name."""
        entries = tomllib.loads((self.public / "dives.toml").read_text("utf-8"))["dive"]
        dives = [{"licence": "unknown", "faults": "unknown"} | dive for dive in entries]
        names = Counter(name_of(dive) for dive in dives)
        same = [name for name, count in names.items() if count > 1]
        if same:
            raise ConfigError(f"dives.toml: more than one dive has the name {listed(same)}")
        return dives

    @property
    def data_sets(self) -> dict[str, list[dict[str, Any]]]:
        """The dives of each data set."""
        found: dict[str, list[dict[str, Any]]] = {}
        for dive in self.dives:
            found.setdefault(data_set_of(dive), []).append(dive)
        return found

    @cached_property
    def logs(self) -> dict[str, Path | UserError]:
        """The log of each dive, by name: one that is there, else one that is fetched, else why there is none."""
        wanted = manifest_dives(self.public / "dives.toml")
        here = self._files_by_digest()
        found = fetch_dives([self._found_here(dive, here) for dive in wanted])
        logs: dict[str, Path | UserError] = {}
        for dive, entry in zip(found, self.dives, strict=True):
            log: Path | UserError = dive.path
            if dive.error is not None:
                log = dive.error
            elif not dive.path.exists():
                log = NOWHERE
            logs[name_of(entry)] = log
        return logs

    @property
    def missing(self) -> dict[str, str]:
        """Why a dive cannot be had, by its name."""
        return {name: log.what for name, log in self.logs.items() if isinstance(log, UserError)}

    def _files_by_digest(self) -> dict[str, Path]:
        """Return the logs and tables that need not be fetched."""
        files: dict[str, Path] = {}
        for path in sorted(self.data.rglob("*")):
            if path.suffix in (*LOG_SUFFIXES, ".csv"):
                files[hashlib.sha256(path.read_bytes()).hexdigest()] = path
        return files

    def _found_here(self, dive: FoundDive, here: Mapping[str, Path]) -> FoundDive:
        """Return a dive with the files that are on this machine already, as far as all of them are."""
        if dive.sha256 in here:
            return FoundDive(here[dive.sha256], vehicle=dive.vehicle)
        digests = [part.file.sha256 for part in dive.parts]
        if not digests or not set(digests) <= set(here):
            return dive
        folder = self.build / "dives" / dive.path.name
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
        for part in dive.parts:
            shutil.copyfile(here[part.file.sha256], folder / part.name)
        return replace(dive, path=folder)


def data_set_of(dive: Mapping[str, Any]) -> str:
    """Return the data set of an entry."""
    return str(dive["tags"][0])


def name_of(dive: Mapping[str, Any]) -> str:
    """Return the name of an entry."""
    return str(dive["tags"][1])
