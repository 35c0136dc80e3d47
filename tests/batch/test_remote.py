"""Remote logs: fetched once, kept by their digest, looked at by ranges; servers that misbehave are refused."""

import hashlib
import json
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import fsspec
import pytest
from camera_logs import with_camera
from mcap.writer import Writer
from remote_server import LogServer, manifest, served
from small_logs import simulated, written

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.found import dive_of_url
from insdvl_replay.batch.manifest import fetch_dives
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import ConfigError, LogError, UserError
from insdvl_replay.inspection.survey import inspect_log, inspect_summary
from insdvl_replay.logs.formats import remote
from insdvl_replay.logs.formats.remote import cache_folder, fetched

LOG, OTHER = simulated(), written()
SHA256 = hashlib.sha256(LOG).hexdigest()
WRONG = "0" * 64
pytestmark = pytest.mark.usefixtures("cache")


@pytest.fixture
def server() -> Iterator[LogServer]:
    with served({"/dive.mcap": LOG}) as told:
        yield told


SHORT_S = (0.01, 0.01, 0.01)


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Fetch one log after the other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "cpu_count", lambda: 1)
        yield


def kept(cache: Path) -> list[Path]:
    return [path for path in cache.rglob("*") if path.is_file()]


def test_a_log_is_fetched_once_and_asked_for_once(server: LogServer) -> None:
    url = f"{server.url}/dive.mcap"
    path = fetched(url, SHA256)
    assert path == cache_folder() / "logs" / SHA256 / "dive.mcap"
    assert path.read_bytes() == LOG
    assert server.asked.count("GET") == 1
    for sha256 in (SHA256, ""):
        server.asked.clear()
        assert fetched(url, sha256) == path
        assert server.asked == ["HEAD"]


def test_the_files_of_a_dive_are_fetched_once_and_kept_for_offline(
    server: LogServer, tmp_path: Path
) -> None:
    url = f"{server.url}/dive.mcap"
    entry = f'path = "seven"\nfiles = [{{ name = "x.mcap", url = "{url}", sha256 = "{SHA256}" }}]'
    dives = find_dives([manifest(tmp_path, entry)])
    (lost,) = fetch_dives(dives, offline=True)
    assert lost.error is not None
    assert "offline nothing is fetched" in lost.error.message
    (found,) = fetch_dives(dives)
    assert [file.name for file in found.path.iterdir()] == ["x.mcap"]
    assert server.asked.count("GET") == 1
    server.asked.clear()
    assert fetch_dives(dives, offline=True) == [found]
    assert server.asked == []
    server.logs["/dive.mcap"] = OTHER
    (changed,) = fetch_dives(find_dives([manifest(tmp_path, entry.replace(SHA256, WRONG))]))
    assert changed.error is not None
    assert "the SHA-256 of what was sent is" in changed.error.message


def test_a_log_that_changed_is_fetched_again_and_refused_if_its_digest_is_known(
    server: LogServer,
) -> None:
    url = f"{server.url}/dive.mcap"
    fetched(url)
    server.logs["/dive.mcap"] = OTHER
    assert fetched(url).read_bytes() == OTHER
    with pytest.raises(LogError, match="the SHA-256 of what was sent is"):
        fetched(url, SHA256)


def test_a_server_that_says_nothing_of_changes_is_asked_for_the_log_each_time(
    server: LogServer,
) -> None:
    server.has_tags = False
    for _ in range(2):
        fetched(f"{server.url}/dive.mcap")
    assert server.asked.count("GET") == 2


def test_without_its_server_a_kept_log_is_used_if_its_digest_is_known(server: LogServer) -> None:
    url = f"{server.url}/dive.mcap"
    path = fetched(url, SHA256)
    server.logs.clear()
    assert fetched(url, SHA256) == path
    with pytest.raises(LogError, match="cannot be fetched"):
        fetched(url)
    path.write_bytes(LOG[:-1])  # a disk that lost bytes
    with pytest.raises(LogError, match="cannot be fetched"):
        fetched(url, SHA256)


@pytest.mark.parametrize(
    ("fault", "sha256"),
    [
        ({"cut": 5000}, ""),
        ({"cut": 5000}, SHA256),
        ({"announced": len(LOG) + 100}, ""),
        ({"announced": len(LOG) + 100}, SHA256),
        ({"announced": len(LOG) - 100}, SHA256),  # always announced and sent, it is another log
        ({"stalls": True}, ""),
        ({"stalls": True}, SHA256),
        ({"changes": True}, ""),
        ({"changes": True}, SHA256),
    ],
)
def test_nothing_is_kept_of_a_server_that_misbehaves(
    server: LogServer,
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: dict[str, Any],
    sha256: str,
) -> None:
    monkeypatch.setattr(remote, "STALLED_S", 0.3)
    for name, value in fault.items():
        setattr(server, name, value)
    with pytest.raises(LogError) as raised:
        fetched(f"{server.url}/dive.mcap", sha256)
    assert raised.value.exit_code == 3
    assert not kept(cache)


@pytest.mark.parametrize("failure", [503, 500, 429, 408, 0])
@pytest.mark.parametrize("failed", [1, 2, 3])
def test_a_server_that_fails_is_asked_again(server: LogServer, failure: int, failed: int) -> None:
    """A try asks with HEAD and, if that fails, with GET."""
    server.failures = [failure] * (2 * failed)
    path = fetched(f"{server.url}/dive.mcap", SHA256, pauses_s=SHORT_S)
    assert path.read_bytes() == LOG
    assert not server.failures
    assert (
        len(server.asked) == 2 * failed + 3
    )  # then what is there, all of it, and if it is still that


@pytest.mark.parametrize("failure", [503, 0])
def test_after_four_tries_the_dive_has_failed_and_the_others_go_on(
    server: LogServer, tmp_path: Path, failure: int
) -> None:
    server.failures = [failure] * 100
    entries = [f'url = "{server.url}/dive.mcap"\nsha256 = "{SHA256}"']
    lost, *_ = fetch_dives(find_dives([manifest(tmp_path, *entries)]), pauses_s=SHORT_S)
    assert lost.error is not None
    assert lost.error.exit_code == 3
    assert "(tried 4 times)" in lost.error.message
    if failure:  # where it hangs up, the library tries once more by itself
        assert server.asked == ["HEAD", "GET"] * 4
    server.logs["/other.mcap"] = OTHER
    server.failures = [503] * 8
    dives = [dive_of_url(f"{server.url}/{name}.mcap") for name in ("dive", "other")]
    with one_at_a_time():
        found = fetch_dives(dives, pauses_s=SHORT_S)
    assert found[0].error is not None
    assert found[1].error is None
    assert found[1].path.read_bytes() == OTHER


def test_a_server_that_failed_four_times_is_asked_once_for_each_other_dive(
    server: LogServer,
) -> None:
    server.failures = [503] * 100
    dives = [dive_of_url(f"{server.url}/{name}.mcap") for name in "abcde"]
    with one_at_a_time():
        found = fetch_dives(dives, pauses_s=SHORT_S)
    assert all(dive.error is not None for dive in found)
    assert server.asked == ["HEAD", "GET"] * (4 + 4)


def test_a_transfer_that_breaks_off_is_begun_again(server: LogServer, cache: Path) -> None:
    server.cuts = [5000, 100, 0]
    path = fetched(f"{server.url}/dive.mcap", pauses_s=SHORT_S)
    assert path.read_bytes() == LOG
    assert server.asked.count("GET") == 4
    assert not list(cache.rglob(".part*"))


@pytest.mark.parametrize("failure", [401, 403, 404, 410])
def test_a_server_that_has_no_such_log_is_asked_once(server: LogServer, failure: int) -> None:
    server.failures = [failure] * 8
    with pytest.raises(LogError, match="cannot be fetched") as raised:
        fetched(f"{server.url}/dive.mcap", pauses_s=SHORT_S)
    assert "tried" not in raised.value.message
    assert server.asked == ["HEAD", "GET"]


def test_a_log_that_is_no_longer_wanted_is_not_waited_for(server: LogServer) -> None:
    server.failures = [503] * 8
    begun_s = time.monotonic()
    with pytest.raises(LogError):
        fetched(f"{server.url}/dive.mcap", is_stopped=lambda: bool(server.asked), pauses_s=[60.0])
    assert time.monotonic() - begun_s < 30.0


def test_tries_end_with_the_longest_transfer(
    server: LogServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("INSDVL_REPLAY_FETCH_HOURS", "0.001")
    server.failures = [503] * 8
    with pytest.raises(LogError):
        fetched(f"{server.url}/dive.mcap", pauses_s=[10.0])
    assert server.asked == ["HEAD", "GET"]


def test_an_inspection_asks_again(server: LogServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "PAUSES_S", SHORT_S)
    server.failures = [503, 0, 502]
    summary = remote.read_summary(f"{server.url}/dive.mcap")
    assert summary.size_bytes == len(LOG)


@pytest.mark.parametrize("url", ["http://127.0.0.1:9/x.mcap", "http://[::1]:9/x.mcap"])
def test_what_cannot_be_fetched_is_an_error_of_that_dive(
    tmp_path: Path, cache: Path, url: str
) -> None:
    (tmp_path / "a.mcap").write_bytes(LOG)
    first, second = fetch_dives(
        find_dives([manifest(tmp_path, f'url = "{url}"\nsha256 = "{WRONG}"', 'path = "a.mcap"')])
    )
    assert isinstance(first.error, UserError)
    assert first.error.exit_code == 3
    assert second.error is None
    assert not kept(cache)


OTHER_URLS = (
    *(
        "memory://dives/none.mcap",
        "unknown://x",
        "s3://",
        "http://user:s3c/ret@x/y",
        "ftp://127.0.0.1/x.mcap",
        "https://",
        "://x",
        "http://[x/y.mcap",
    ),
    *("reference://dive.mcap::file:///refs.json", "zip://a.mcap::http://127.0.0.1:9/x.zip"),
    *(
        "simplecache::http://127.0.0.1:9/x.mcap",
        "http::https://x/y.mcap",
        "file://elsewhere/x.mcap",
    ),
)


@pytest.mark.parametrize("url", OTHER_URLS)
@pytest.mark.parametrize("place", ["argument", "list.txt", "dives.toml"])
def test_other_urls_and_chains_are_refused_by_name(url: str, place: str, tmp_path: Path) -> None:
    name = url
    if place == "list.txt":
        (tmp_path / place).write_text(f"{url}\n")
        name = str(tmp_path / place)
    elif place == "dives.toml":
        name = manifest(tmp_path, f'url = "{url}"\nsha256 = "{WRONG}"')
    with pytest.raises(ConfigError) as raised:
        find_dives([name])
    assert raised.value.hint


def test_a_url_of_a_file_is_that_file(tmp_path: Path, cache: Path) -> None:
    (tmp_path / "a dive.mcap").write_bytes(LOG)
    url = f"file://{tmp_path}/a%20dive.mcap"
    (dive,) = fetch_dives(find_dives([url]))
    assert (dive.path, dive.error) == (tmp_path / "a dive.mcap", None)
    (dive,) = fetch_dives(find_dives([manifest(tmp_path, f'url = "{url}"\nsha256 = "{WRONG}"')]))
    assert isinstance(dive.error, LogError)
    assert not cache.exists()


def test_a_transfer_ends_at_the_longest_log_and_time(
    server: LogServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"{server.url}/dive.mcap"
    monkeypatch.setenv("INSDVL_REPLAY_FETCH_GB", "1e-5")
    with pytest.raises(LogError, match=r"has .* GB: logs of more than 1e-05 GB are not fetched"):
        fetched(url, SHA256)
    server.is_endless = True
    server.has_length = False
    with pytest.raises(LogError, match="logs of more than 1e-05 GB are not fetched") as raised:
        fetched(url, SHA256)
    assert "INSDVL_REPLAY_FETCH_GB" in raised.value.hint
    monkeypatch.setenv("INSDVL_REPLAY_FETCH_GB", "1")
    monkeypatch.setenv("INSDVL_REPLAY_FETCH_HOURS", "0.0001")
    server.drips_s = 0.1
    with pytest.raises(LogError, match=r"it takes longer than 0\.36 s"):
        fetched(url, SHA256)
    assert not kept(cache)
    monkeypatch.setenv("INSDVL_REPLAY_FETCH_HOURS", "six")
    with pytest.raises(ConfigError, match="INSDVL_REPLAY_FETCH_HOURS=six"):
        fetched(url, SHA256)


def test_an_inspection_ends_where_a_server_drips(
    server: LogServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "ANSWERED_S", 0.3)
    server.drips_s = 0.1
    with pytest.raises(LogError, match=r"it takes longer than 0\.3 s"):
        inspect_summary(f"{server.url}/dive.mcap", Config())


def test_offline_nothing_is_asked_for(
    server: LogServer, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"{server.url}/dive.mcap"
    command = ["inspect", url, "--offline", "--format", "json"]
    assert run_command_line(command) == 3
    assert "is not kept from an earlier command" in capsys.readouterr().err
    assert not server.asked
    fetched(url)
    server.asked.clear()
    assert run_command_line(command) == 0
    assert not server.asked


def test_only_their_owner_reads_logs_that_were_fetched(server: LogServer, cache: Path) -> None:
    path = fetched(f"{server.url}/dive.mcap", SHA256)
    assert path.parent.parent.stat().st_mode & 0o777 == path.parent.stat().st_mode & 0o777 == 0o700
    assert [file.stat().st_mode & 0o777 for file in kept(cache)] == [0o600, 0o600]


@pytest.mark.parametrize("command", ["run", "inspect", "calibrate"])
def test_nothing_that_gives_access_is_printed(
    command: str, server: LogServer, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    host = server.url.removeprefix("http://")
    for url in (
        f"http://user:s3cret@{host}/none.mcap?X-Sig=SIGNED&b=1#FRAG",
        "http://user:s3c/ret@127.0.0.1:9/x?SIGNED",
    ):
        more = ["--rerun"] if command == "run" else []
        output = [] if command == "inspect" else ["-o", str(tmp_path / "out.toml")]
        assert run_command_line([command, url, *output, *more, "-vv"]) in (2, 3)
        printed = "".join(capsys.readouterr())
        assert "error: http://127.0.0.1" in printed
        assert not {word for word in ("s3c", "ret@", "SIGNED", "FRAG") if word in printed}, printed


def test_a_fault_of_a_fetched_log_names_its_url(
    server: LogServer, tmp_path: Path, cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.logs["/dive.mcap?sig=SIGNED"] = LOG[:100]
    url = f"{server.url}/dive.mcap"
    out = tmp_path / "out"
    assert run_command_line(["run", f"{url}?sig=SIGNED", "-o", str(out)]) == 3
    printed = "".join(capsys.readouterr())
    assert f"{url}?..." in printed
    assert str(cache) not in printed
    assert "SIGNED" not in printed


def test_a_url_is_a_dive_whose_results_hold_nothing_that_gives_access(
    server: LogServer, tmp_path: Path
) -> None:
    server.logs["/dive.mcap?sig=SIGNED"] = LOG
    url = f"http://user:s3cret@{server.url.removeprefix('http://')}/dive.mcap?sig=SIGNED"
    out = tmp_path / "out"
    assert run_command_line(["run", url, "-o", str(out), "-q", "--starts", "1"]) == 0
    assert (out / "dive" / "report.json").is_file()
    for file in out.rglob("*"):
        assert file.is_dir() or not {b"s3cret", b"SIGNED"} & set(
            re.findall(b"s3cret|SIGNED", file.read_bytes())
        )
        assert "s3cret" not in file.name


def test_a_second_check_asks_once_for_each_dive_and_reads_no_log(tmp_path: Path) -> None:
    with served({f"/dive_{number}.mcap": LOG for number in range(8)}) as server:
        lines = [f'url = "{server.url}{path}"\nsha256 = "{SHA256}"' for path in server.logs]
        manifest(tmp_path, *lines)
        gates = tmp_path / "gates.toml"
        gates.write_text(
            'dives = ["dives.toml"]\n[[gate]]\nname = "calm"\ntable = "consistency"\ncolumn = "mean_nis"\nmax = 9\n'
        )
        # One log under 8 names; the settings are those of one quick replay.
        command = [
            "check",
            str(gates),
            "--results",
            str(tmp_path / "out"),
            "--set",
            "evaluation.starts=1",
        ]
        first = run_command_line(command)
        assert server.asked.count("GET") == 8
        server.asked.clear()
        server.sent = 0
        assert run_command_line(command) == first
        assert server.asked == ["HEAD"] * 8
        assert server.sent == 0


def test_logs_of_one_name_are_named_after_their_urls(tmp_path: Path) -> None:
    with served({"/x/log.mcap": LOG, "/y/log.mcap": LOG}) as server:
        urls = [f"{server.url}/{folder}/log.mcap" for folder in ("x", "y", "none")]
        assert (
            run_command_line(["run", *urls, "--starts", "1", "-q", "-o", str(tmp_path / "out")])
            == 3
        )
    assert {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()} == {
        "x_log",
        "y_log",
    }


def test_a_log_of_unknown_length_needs_a_digest(server: LogServer, cache: Path) -> None:
    server.has_length = False
    server.cut = 5000
    with pytest.raises(LogError, match="does not say how long it is"):
        fetched(f"{server.url}/dive.mcap")
    with pytest.raises(LogError, match="the SHA-256 of what was sent"):
        fetched(f"{server.url}/dive.mcap", SHA256)
    assert not kept(cache)


def test_a_server_that_stalled_is_not_asked_for_other_dives(
    server: LogServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "STALLED_S", 0.2)
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    server.stalls = True
    server.logs |= {f"/{number}.mcap": LOG for number in range(8)}
    lines = [f'url = "{server.url}{path}"\nsha256 = "{SHA256}"' for path in server.logs]
    dives = fetch_dives(find_dives([manifest(tmp_path, *lines)]))
    assert sum("stalled before" in str(dive.error) for dive in dives) == 8
    assert server.asked.count("GET") == 4  # the tries for the first


def test_a_transfer_ends_that_is_not_wanted_or_longer_than_announced(
    server: LogServer, cache: Path
) -> None:
    with pytest.raises(LogError, match="stopped"):
        fetched(f"{server.url}/dive.mcap", "", lambda: True)
    server.head_announces = 5000
    with pytest.raises(LogError, match="more than the 5000 bytes"):
        fetched(f"{server.url}/dive.mcap", SHA256)
    assert not kept(cache)


@pytest.mark.parametrize("content", ["[]", '"x"', "null", "{", '{"sha256": 3}'])
def test_what_is_known_of_servers_may_be_damaged(server: LogServer, content: str) -> None:
    fetched(f"{server.url}/dive.mcap")
    (said,) = cache_folder().glob("urls/*.json")
    said.write_text(content)
    assert fetched(f"{server.url}/dive.mcap").read_bytes() == LOG


def test_a_cache_that_cannot_be_written_is_named(
    server: LogServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(LogError, match=r"cannot be kept in .*file"):
        fetched(f"{server.url}/dive.mcap")


def test_parts_of_killed_processes_are_removed(server: LogServer, cache: Path) -> None:
    left, now = (cache / "insdvl-replay" / "logs" / name for name in (".part_old", ".part_now"))
    for folder in (left, now):
        folder.mkdir(parents=True)
        (folder / "dive.mcap").write_bytes(LOG)
    for folder, hours in ((left, 25.0), (now, 23.0)):
        os.utime(folder, (0.0, time.time() - 3600.0 * hours))
    fetched(f"{server.url}/dive.mcap")
    assert not left.exists()
    assert now.exists()


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("https://x/a%20b.mcap?token=1", "a b.mcap"),
        ("https://x/..", "dive"),
        ("https://x", "dive"),
        (f"https://x/{'y' * 300}.mcap", "dive.mcap"),
    ],
)
def test_names_of_logs_come_from_their_urls(url: str, name: str) -> None:
    assert str(remote.remote_name(url)) == name


# --- Inspection by ranges


def test_inspection_reads_the_summary_alone(
    server: LogServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "dive.mcap").write_bytes(b"another dive of this name")
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["inspect", f"{server.url}/dive.mcap"]) == 0
    assert "has what a replay needs by its summary" in capsys.readouterr().out
    assert server.asked == ["GET"]


def test_a_summary_tells_what_the_log_tells(server: LogServer, tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(LOG)
    ours, whole = inspect_summary(f"{server.url}/dive.mcap", Config()), inspect_log(path, Config())
    assert ours.log.messages == whole.log.messages
    assert ours.log.start_utc == whole.log.start_utc
    assert ours.log.duration_s == pytest.approx(whole.log.duration_s)
    assert ours.roles == whole.roles
    assert ours.conventions == whole.conventions
    for mine, other in zip(ours.topics, whole.topics, strict=True):
        assert (mine.topic, mine.role, mine.messages) == (other.topic, other.role, other.messages)
        assert mine.rate_hz == pytest.approx(other.rate_hz, rel=0.06)  # over whole chunks


def long_log(hours: float, chunk_s: float) -> bytes:
    """Write a log with the chunks and 12 channels of a long dive, and short messages."""
    stream, period_ns = BytesIO(), int(chunk_s * 1e9)
    writer = Writer(stream, chunk_size=600)
    writer.start()
    schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"float64 x")
    ids = [writer.register_channel(f"/topic_{number}", "cdr", schema) for number in range(12)]
    for time_ns in range(0, int(hours * 3600e9), period_ns):
        for id_ in ids:
            writer.add_message(id_, time_ns, b"x" * 20, time_ns)
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize(
    "chunk_s",
    [
        pytest.param(20.0, id="1 MB of sensors"),
        pytest.param(2.0, marks=pytest.mark.nightly, id="1 MB with a camera"),
    ],
)
def test_a_log_of_six_hours_takes_two_requests_and_512_kib(chunk_s: float) -> None:
    with served({"/long.mcap": long_log(6.0, chunk_s)}) as server:
        found = inspect_summary(f"{server.url}/long.mcap", Config())
        assert len(found.topics) == 12
        assert found.log.duration_s == pytest.approx(6 * 3600 - chunk_s)
        assert found.topics[0].rate_hz == pytest.approx(1.0 / chunk_s)
        assert len(server.asked) == 2
        assert server.sent <= 512 << 10


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"has_ranges": False}, "does not send parts"),
        ({"flips": True}, "checksum of the summary"),
        ({"stalls": True}, "cannot be fetched"),
        ({"cut": 100}, "other bytes|cannot be fetched"),
        ({"announced": 100}, "other bytes"),
    ],
)
@pytest.mark.nightly
def test_a_summary_that_cannot_be_trusted_is_refused(
    server: LogServer, monkeypatch: pytest.MonkeyPatch, fault: dict[str, Any], said: str
) -> None:
    monkeypatch.setattr(remote, "STALLED_S", 0.3)
    for name, value in fault.items():
        setattr(server, name, value)
    with pytest.raises(LogError, match=said):
        inspect_summary(f"{server.url}/dive.mcap", Config())


@pytest.mark.parametrize(
    ("content", "said"), [(b"x" * 5000, "does not end as an MCAP file"), (b"x", "does not end")]
)
def test_other_files_have_no_summary(server: LogServer, content: bytes, said: str) -> None:
    server.logs["/dive.mcap"] = content
    with pytest.raises(LogError, match=said):
        inspect_summary(f"{server.url}/dive.mcap", Config())


# --- A real S3 service


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A bucket of a server that speaks the protocol of S3."""
    moto = pytest.importorskip("moto.server")
    pytest.importorskip("s3fs")
    service = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    service.start()
    host, port = service.get_host_and_port()
    for key, value in {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "anybody",
        "AWS_SECRET_ACCESS_KEY": "anything",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(key, value)
    system = fsspec.filesystem("s3", skip_instance_cache=True)
    system.makedirs("dives", exist_ok=True)
    yield system
    service.stop()


@pytest.mark.nightly
def test_logs_in_a_bucket(bucket: Any, tmp_path: Path, cache: Path) -> None:
    bucket.pipe("dives/dive.mcap", LOG)
    url = "s3://dives/dive.mcap"
    assert fetched(url, SHA256).read_bytes() == LOG
    assert fetched(url) == fetched(url, SHA256)
    assert len(json.loads(next(cache.rglob("urls/*.json")).read_bytes())["state"]) > 1
    assert [role.topic for role in inspect_summary(url, Config()).roles if role.role == "dvl"] == [
        "/dvl"
    ]
    bucket.pipe("dives/dive.mcap", OTHER)
    assert fetched(url).read_bytes() == OTHER
    with pytest.raises(LogError, match="the SHA-256 of what was sent is"):
        fetched(url, SHA256)
    with pytest.raises(LogError, match="cannot be fetched"):
        fetched("s3://dives/none.mcap")


@pytest.mark.nightly
def test_of_a_log_in_a_bucket_that_a_camera_fills_parts_are_fetched(
    bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "LEAST_BYTES", 1 << 20)
    log = tmp_path / "camera.mcap"
    with_camera(log, LOG, 100_000, 20)
    bucket.pipe("dives/camera.mcap", log.read_bytes())
    path = fetched("s3://dives/camera.mcap")
    assert path.stat().st_size < 0.5 * log.stat().st_size
    ours, whole = inspect_log(path, Config()), inspect_log(log, Config())
    assert ours.roles == whole.roles
