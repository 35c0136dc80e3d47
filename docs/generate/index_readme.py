"""The README on a package index, which has none of the project's files: each link leads to the repository.

Where pyproject.toml names no `Repository`, such a link becomes its text, and a picture is left out.
"""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:)([^)\s]+)\)")


class IndexReadme(MetadataHookInterface):
    """Give the package its readme as it is built."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the readme."""
        page = Path(self.root, "README.md").read_text("utf-8")
        text = for_index(page, metadata.get("urls", {}).get("Repository", ""))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def for_index(page: str, repository: str) -> str:
    """Return the page with links that lead somewhere from anywhere."""

    def absolute(link: re.Match[str]) -> str:
        mark, text, address = link.groups()
        if address.startswith("#"):
            return link[0]
        if not repository:
            return "" if mark else text
        return f"{mark}[{text}]({repository}/{'raw' if mark else 'blob'}/HEAD/{address})"

    return LINK.sub(absolute, page)
