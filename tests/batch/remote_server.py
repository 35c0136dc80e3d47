"""A server of logs on this machine, which counts what it is asked for, and can be told to misbehave."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import repeat
from pathlib import Path
from typing import Any


class LogServer:
    """What is served, how, and what was asked for."""

    def __init__(self, logs: dict[str, bytes]) -> None:
        self.logs = logs  # by path
        self.asked: list[str] = []  # methods
        self.sent = 0  # bytes of logs
        self.url = ""
        self.cut: int | None = None  # bytes after which it drops the connection
        self.cuts: list[int] = []  # likewise, for the next transfers
        self.announced: int | None = None  # length that it announces instead of the true one
        self.head_announces: int | None = None  # likewise, without content
        self.has_length = True
        self.stalls = False
        self.failures: list[int] = []  # how it fails the next requests: a status, or 0 to hang up
        self.has_ranges = True
        self.has_tags = True
        self.changes = False  # with every answer
        self.flips = False  # one bit of what it sends
        self.is_endless = False  # sends without an end and without a length
        self.drips_s = 0.0  # between single bytes


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def __init__(self, server: LogServer, *arguments: Any) -> None:
        self.told = server
        super().__init__(*arguments)

    def do_HEAD(self) -> None:
        self._answer(with_content=False)

    def do_GET(self) -> None:
        self._answer(with_content=True)

    def _answer(self, *, with_content: bool) -> None:
        told = self.told
        told.asked.append(self.command)
        if told.failures:
            status = told.failures.pop(0)
            if status:
                self.send_error(status)
            self.close_connection = True
            return
        if (log := told.logs.get(self.path)) is None:
            self.send_error(404)
            return
        content, wanted = log, self.headers.get("Range")
        if wanted and told.has_ranges:
            first, _, last = wanted.removeprefix("bytes=").partition("-")
            start = int(first) if first else max(len(log) - int(last), 0)
            content = log[start : int(last) + 1 if first and last else len(log)]
            self.send_response(206)
            self.send_header(
                "Content-Range", f"bytes {start}-{start + len(content) - 1}/{len(log)}"
            )
        else:
            self.send_response(200)
        if told.flips:
            content = content[:-40] + bytes([content[-40] ^ 1]) + content[-39:]
        announced = (
            told.head_announces if told.head_announces and not with_content else told.announced
        )
        if told.has_length:
            self.send_header("Content-Length", str(announced or len(content)))
        if told.has_tags:
            self.send_header("ETag", f'"{hash(log)}-{len(told.asked) * told.changes}"')
        self.end_headers()
        if not with_content:
            return
        if told.is_endless or told.drips_s:
            self.close_connection = True
            with suppress(OSError):  # the client went away
                for byte in content if told.drips_s else repeat(0):
                    self.wfile.write(bytes([byte]) if told.drips_s else bytes(1 << 16))
                    time.sleep(told.drips_s)
            return
        if told.stalls:
            time.sleep(2.0)
            self.close_connection = True
            return
        if told.cuts:
            self.wfile.write(content[: told.cuts.pop(0)])
            self.close_connection = True
            return
        part = content if told.cut is None else content[: told.cut]
        self.wfile.write(part)
        told.sent += len(part)
        self.close_connection = (
            told.cut is not None or told.announced is not None or not told.has_length
        )

    def log_message(self, *_: Any) -> None:
        pass


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, *_: Any) -> None:
        """Say nothing of clients that went away."""


@contextmanager
def served(logs: dict[str, bytes]) -> Iterator[LogServer]:
    """Serve logs by their paths, such as ``/dive.mcap``."""
    told = LogServer(logs)
    with _Server(("127.0.0.1", 0), partial(_Handler, told)) as server:
        thread = threading.Thread(
            target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True
        )
        thread.start()
        told.url = f"http://127.0.0.1:{server.server_port}"
        yield told
        server.shutdown()
        thread.join()


def manifest(folder: Path, *dives: str) -> str:
    """Write a manifest of dives, each by its keys, and return its path."""
    path = folder / "dives.toml"
    path.write_text("".join(f"[[dive]]\n{dive}\n" for dive in dives))
    return str(path)
