"""Manifests: dives by path and by URL, with digests that must be right; a log that was fetched is not fetched again."""

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import fsspec
import pytest
from small_logs import written

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.manifest import cache_folder
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.logs.formats.recording import open_recording

LOG = written()
SHA256 = hashlib.sha256(LOG).hexdigest()
WRONG = "0" * 64


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def memory() -> Iterator[Any]:
    """A file system without files, by the URL ``memory://``."""
    system = fsspec.filesystem("memory")
    system.pipe("/dives/dive 1.mcap", LOG)
    yield system
    system.rm("/dives", recursive=True)


def manifest(folder: Path, *dives: str) -> str:
    path = folder / "dives.toml"
    path.write_text("".join(f"[[dive]]\n{dive}\n" for dive in dives))
    return str(path)


def test_paths_are_relative_to_the_manifest_and_chosen_by_tag(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.mcap").write_bytes(LOG)
    listed = manifest(
        tmp_path,
        f'path = "a.mcap"\nsha256 = "{SHA256}"\nlicence = "CC-BY-4.0"\ntags = ["deep", "calm"]',
        'path = "b.mcap"\ntags = ["calm"]',
    )
    assert [path.name for path in find_dives([listed])] == ["a.mcap", "b.mcap"]
    assert [path.name for path in find_dives([f"{listed}#deep"])] == ["a.mcap"]
    with pytest.raises(ConfigError, match="no dive has the tag 'windy'") as raised:
        find_dives([f"{listed}#windy"])
    assert raised.value.hint == "its tags are calm, deep"


def test_a_folder_has_the_digest_of_its_report(tmp_path: Path) -> None:
    folder = tmp_path / "dive"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.mcap").write_bytes(LOG)
    digest = open_recording(folder).sha256()
    assert find_dives([manifest(tmp_path, f'path = "dive"\nsha256 = "{digest}"')]) == [folder]
    with pytest.raises(LogError, match=digest):
        find_dives([manifest(tmp_path, f'path = "dive"\nsha256 = "{WRONG}"')])


@pytest.mark.parametrize(
    "line", ['path = "a"\nurl = "b"', 'url = "https://x/y.mcap"', "tags = []", 'sha256 = "abc"', "x = 1"]
)
def test_a_wrong_entry_is_a_wrong_setting(tmp_path: Path, line: str) -> None:
    with pytest.raises(ConfigError, match=r"dives\.toml"):
        find_dives([manifest(tmp_path, line)])


def test_a_wrong_digest_ends_with_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.mcap").write_bytes(LOG)
    listed = manifest(tmp_path, f'path = "a.mcap"\nsha256 = "{WRONG}"')
    assert run_command_line(["run", listed, "-o", str(tmp_path / "out")]) == 3
    assert f"its SHA-256 is {SHA256}" in capsys.readouterr().err


def test_a_url_without_a_digest_leads_to_a_manifest() -> None:
    with pytest.raises(ConfigError, match="a remote log needs its digest"):
        find_dives(["https://example.org/dive.mcap"])


def test_a_remote_log_is_fetched_once(tmp_path: Path, memory: Any) -> None:
    listed = manifest(tmp_path, f'url = "memory://dives/dive 1.mcap"\nsha256 = "{SHA256}"')
    (path,) = find_dives([listed])
    assert path == cache_folder() / SHA256 / "dive 1.mcap"
    assert path.read_bytes() == LOG
    memory.pipe("/dives/dive 1.mcap", b"something else")
    assert find_dives([listed]) == [path]


def test_of_a_log_with_another_digest_nothing_is_kept(tmp_path: Path, memory: Any, cache: Path) -> None:
    for url in ("memory://dives/dive 1.mcap", "memory://dives/none.mcap", "unknown://x"):
        with pytest.raises(LogError, match=r"the SHA-256 of what was sent|cannot be fetched") as raised:
            find_dives([manifest(tmp_path, f'url = "{url}"\nsha256 = "{WRONG}"')])
        assert raised.value.exit_code == 3
    assert not [path for path in cache.rglob("*") if path.is_file()]


class Server(BaseHTTPRequestHandler):
    """Says how long a log is, sends a part of it, and drops the connection; counts what it is asked for."""

    def __init__(self, sent: bytes, asked: list[str], *arguments: Any) -> None:
        self.sent, self.asked = sent, asked
        super().__init__(*arguments)

    def do_HEAD(self) -> None:
        self.asked.append(self.command)
        self.send_response(200)
        self.send_header("Content-Length", str(len(LOG)))
        self.end_headers()

    def do_GET(self) -> None:
        self.do_HEAD()
        self.wfile.write(self.sent)

    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def served(sent: bytes) -> Iterator[tuple[str, list[str]]]:
    """Yield the URL of a log, and what its server was asked for."""
    asked: list[str] = []
    with HTTPServer(("127.0.0.1", 0), partial(Server, sent, asked)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/dive.mcap", asked
        server.shutdown()
        thread.join()


def test_a_server_is_asked_once_for_a_log(tmp_path: Path) -> None:
    with served(LOG) as (url, asked):
        listed = manifest(tmp_path, f'url = "{url}"\nsha256 = "{SHA256}"')
        (path,) = find_dives([listed])
        assert path.read_bytes() == LOG
        assert asked.count("GET") == 1
        asked.clear()
        assert find_dives([listed]) == [path]
        assert not asked


def test_a_server_that_lies_about_the_length_is_refused(tmp_path: Path, cache: Path) -> None:
    with served(LOG[:5000]) as (url, _), pytest.raises(LogError, match=r"SHA-256 of what was sent|cannot be fetched"):
        find_dives([manifest(tmp_path, f'url = "{url}"\nsha256 = "{SHA256}"')])
    assert not [path for path in cache.rglob("*") if path.is_file()]
