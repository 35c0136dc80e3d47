"""SECURITY.md names the modules that open connections, start processes and write files; no other module does it."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "insdvl_replay"
NETWORK = (
    *(
        "socket",
        "ssl",
        "http",
        "urllib.request",
        "urllib3",
        "requests",
        "aiohttp",
        "asyncio",
        "ftplib",
        "smtplib",
    ),
    *("socketserver", "xmlrpc", "fsspec", "s3fs", "gcsfs", "distributed", "webbrowser"),
)
PROCESSES = (
    "subprocess",
    "multiprocessing",
    "pty",
    "os.system",
    "os.popen",
    "os.fork",
    "os.posix_spawn",
    "os.execv",
)
WRITING = {
    *(
        "write_text",
        "write_bytes",
        "touch",
        "mkdir",
        "makedirs",
        "rmdir",
        "unlink",
        "rmtree",
        "rename",
        "symlink_to",
    ),
    *(
        "hardlink_to",
        "copyfile",
        "chmod",
        "save",
        "savez",
        "savez_compressed",
        "savefig",
        "write_table",
        "mkdtemp",
        "mkstemp",
    ),
    *(
        "TemporaryDirectory",
        "TemporaryFile",
        "NamedTemporaryFile",
        "ParquetWriter",
        "to_csv",
        "to_parquet",
    ),
}


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(ast.parse(path.read_text("utf-8"))))


def name_of(called: ast.expr) -> str:
    """Return the last name of what is called."""
    if isinstance(called, ast.Attribute):
        return called.attr
    return str(getattr(called, "id", ""))


def used_names(path: Path) -> Iterator[str]:
    """Give the dotted names that a module imports, also by a call, and those of `os` that it uses."""
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            yield f"{node.value.id}.{node.attr}"
        elif (
            isinstance(node, ast.Call)
            and name_of(node.func).endswith("import_module")
            and node.args
        ):
            yield ast.unparse(node.args[0]).strip("'")


def uses(path: Path, wanted: tuple[str, ...]) -> bool:
    return any(
        name == one or name.startswith(f"{one}.") for name in used_names(path) for one in wanted
    )


def starts_processes(path: Path) -> bool:
    """Return whether a module has what starts processes; a finalizer, which a process runs at its end, does not."""
    for name in used_names(path):
        if name in ("multiprocessing.util", "multiprocessing.util.Finalize"):
            continue
        if any(name == one or name.startswith(f"{one}.") for one in PROCESSES):
            return True
    return False


def writes(path: Path) -> bool:
    """Return whether a module calls what makes, changes or removes a file."""
    for node in nodes(path):
        if not isinstance(node, ast.Call):
            continue
        name = name_of(node.func)
        words = [
            one.value
            for one in node.args
            if isinstance(one, ast.Constant) and isinstance(one.value, str)
        ]
        is_open = name in ("open", "fdopen") and any(
            re.fullmatch("[rwxabt+]{1,3}", one) for one in words
        )
        if name in WRITING or (is_open and any(set(one) & set("wxa+") for one in words)):
            return True
    return False


def named(row: str) -> set[str]:
    """Read the modules that a row of SECURITY.md names."""
    (line,) = re.findall(
        rf"^\| {row} \|(.*)$", (ROOT / "SECURITY.md").read_text("utf-8"), re.MULTILINE
    )
    return set(re.findall(r"`([\w/]+\.py)`", line))


@pytest.mark.parametrize(
    ("row", "is_so"),
    [
        ("open connections", lambda path: uses(path, NETWORK)),
        ("start processes", starts_processes),
        ("write files", writes),
    ],
    ids=["connections", "processes", "files"],
)
def test_the_modules_are_those_of_the_page(row: str, is_so: object) -> None:
    assert callable(is_so)
    found = {path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if is_so(path)}
    assert found == named(row)
