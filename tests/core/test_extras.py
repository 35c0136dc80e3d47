"""Hints on optional packages name the packages, which are found wherever the project was installed from."""

import re
import sys
from importlib import metadata
from pathlib import Path

import pytest

from insdvl_replay.core.extras import Extra, install_hint

PROJECT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("extra", "packages"),
    [
        ("figures", ["matplotlib"]),
        ("tables", ["pyarrow"]),
        ("remote", ["aiohttp", "fsspec", "s3fs"]),
        ("cluster", ["distributed"]),
    ],
)
def test_hint_names_the_packages_of_an_extra(extra: Extra, packages: list[str]) -> None:
    command = install_hint(extra)
    assert command.startswith("pip install ")
    assert all(f"'{package}" in command for package in packages)


def test_without_metadata_the_hint_leads_to_a_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "requires", lambda _: None)
    assert install_hint("figures").endswith("pip install '.[figures]'")


@pytest.mark.parametrize(
    ("file", "begins"),
    [
        ("pipx_metadata.json", "pipx inject insdvl-replay 'matplotlib"),
        ("uv-receipt.toml", f"uv pip install --python {sys.executable} 'matplotlib"),
    ],
)
def test_an_environment_of_a_tool_gets_the_packages(
    file: str, begins: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What pip installs elsewhere would not be found. test_installation asks both tools themselves."""
    (tmp_path / file).touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert install_hint("figures").startswith(begins)


def test_nothing_sends_to_a_package_index_for_the_project_itself() -> None:
    """It is on none: what installs it names a checkout, a wheel or an address."""
    texts = [path for path in PROJECT.glob("*") if path.suffix in (".md", ".yml")]
    for folder in ("insdvl_replay", "docs", "examples", ".github"):
        for suffix in ("*.py", "*.md", "*.yml", "*.ipynb", "*.toml", "Dockerfile"):
            texts += (PROJECT / folder).rglob(suffix)
    assert len(texts) > 300
    by_name = re.compile(r"(pip|pipx|tool) install [^\n]*(?<![/\w.-])insdvl-replay\b(?!\.git)")
    found = [path.name for path in texts if by_name.search(path.read_text("utf-8"))]
    assert found == []
