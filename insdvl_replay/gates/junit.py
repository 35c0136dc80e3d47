"""What became of the gates as JUnit XML: a suite for each dive, a case for each gate.

Source: the schema junit-10.xsd of Jenkins' xUnit plugin, which GitLab and others read, too. It has no word for a
warning; one is told as a case that was skipped, so that it never counts as passed.
"""

import re
from typing import Final
from xml.etree import ElementTree

from insdvl_replay.core.plain_text import visible, visible_lines
from insdvl_replay.gates.model import CheckResult, Judgement, Status

_ELEMENTS: Final[dict[Status, str]] = {
    "unusable": "error",
    "failed": "failure",
    "warning": "skipped",
    "off": "skipped",
}
_NOT_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(result: CheckResult) -> str:
    """Write JUnit XML."""
    root = ElementTree.Element("testsuites", {"name": _clean(result.gates), **_counts(result.judgements)})
    for dive in dict.fromkeys(judgement.dive for judgement in result.judgements):
        own = tuple(judgement for judgement in result.judgements if judgement.dive == dive)
        skipped = str(sum(_ELEMENTS.get(judgement.status) == "skipped" for judgement in own))
        attributes = {"name": _clean(dive), **_counts(own), "skipped": skipped}
        suite = ElementTree.SubElement(root, "testsuite", attributes)
        for judgement in own:
            _add_case(suite, judgement)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _counts(judgements: tuple[Judgement, ...]) -> dict[str, str]:
    def count(status: Status) -> str:
        return str(sum(judgement.status == status for judgement in judgements))

    return {"tests": str(len(judgements)), "failures": count("failed"), "errors": count("unusable")}


def _add_case(suite: ElementTree.Element, judgement: Judgement) -> None:
    names = {"classname": _clean(judgement.dive), "name": _clean(judgement.gate)}
    case = ElementTree.SubElement(suite, "testcase", names)
    if element := _ELEMENTS.get(judgement.status):
        message = {"message": _clean("; ".join(map(visible, judgement.reasons)) or judgement.status)}
        kind = {} if element == "skipped" else {"type": judgement.status}
        told = ElementTree.SubElement(case, element, {**message, **kind})
        told.text = _clean("\n".join(map(visible, judgement.reasons)))


def _clean(text: str) -> str:
    """Show control characters, which XML cannot hold, and leave out what else it cannot."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", visible_lines(text))
