"""What tests of manifests and of remote logs share."""

from pathlib import Path

import pytest

from insdvl_replay.logs.formats import remote


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder for logs that are fetched, with short pauses before a server is asked again."""
    monkeypatch.setattr(remote, "PAUSES_S", (0.01, 0.01, 0.01))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"
