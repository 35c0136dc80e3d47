"""Hints on optional packages name the packages, which are found wherever the project was installed from."""

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


def test_nothing_sends_to_a_package_index_for_the_project_itself() -> None:
    texts = [
        *(PROJECT / "insdvl_replay").rglob("*.py"),
        *(PROJECT / "docs").glob("*.md"),
        PROJECT / "README.md",
    ]
    assert [
        path.name for path in texts if "install 'insdvl-replay" in path.read_text("utf-8")
    ] == []
