"""The page of a study: what it found in words, numbers and pictures, and where that comes from."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from insdvl_replay.core.config_file import render_toml
from insdvl_replay.report.page import Heading, Lead, Part, page
from insdvl_replay.report.page_parts import facts, losses, picture, settings_details
from insdvl_replay.results.json_report import Tool, package_versions

if TYPE_CHECKING:
    from insdvl_replay.studies.study_report import StudyReport


def study_page(report: "StudyReport", pictures: Mapping[str, bytes]) -> bytes:
    """Write the page of a study.

    Parameters
    ----------
    report : StudyReport
    pictures : mapping of str to bytes
        SVG by name.

    Returns
    -------
    bytes
        The same study gives the same bytes.
    """
    tool = Tool()
    asked = {
        name: ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        for name, value in report.arguments.items()
    }
    versions = ", ".join(f"{name} {version}" for name, version in package_versions().items())
    parts: list[Part] = [
        *map(Lead, report.sentences),
        Heading("Pictures"),
        *(picture(name, svg) for name, svg in pictures.items()),
        Heading("Tables"),
        *report.shown,
        Heading("What was lost or assumed"),
        losses(report.notes),
        Heading("Provenance"),
        facts({**asked, "tool": f"{tool.name} {tool.version}", "with": versions}),
        settings_details(render_toml(report.config)),
    ]
    return page(report.title, parts)
