"""The list of all packages of a release, as CycloneDX 1.6: those of requirements.lock, with their digests.

The time is not in it, so that the same release gives the same bytes.
"""

import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from written import PROJECT

from insdvl_replay.core.version import __version__

_PACKAGE = re.compile(r"^([\w.-]+)==(\S+)((?: --hash=sha256:[0-9a-f]{64})+)", re.MULTILINE)


def component(name: str, version: str, digests: list[str]) -> dict[str, Any]:
    """Describe a package by its name on the index, and the digests of its wheels."""
    purl = f"pkg:pypi/{name}@{version}"
    files = [
        {"type": "distribution", "url": purl, "hashes": [{"alg": "SHA-256", "content": digest}]}
        for digest in digests
    ]
    return {
        "type": "library",
        "bom-ref": purl,
        "name": name,
        "version": version,
        "purl": purl,
        "externalReferences": files,
    }


def sbom() -> dict[str, Any]:
    """Return the list."""
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]
    lock = (PROJECT / "requirements.lock").read_text("utf-8").replace("\\\n", " ")
    components = []
    for name, version, hashes in _PACKAGE.findall(re.sub(r" +", " ", lock)):
        components.append(component(name, version, re.findall(r"sha256:(\w+)", hashes)))
    own = {
        "type": "application",
        "bom-ref": project["name"],
        "name": project["name"],
        "version": __version__,
        "licenses": [{"license": {"id": project["license"]}}],
    }
    needed = [one["bom-ref"] for one in components]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": own},
        "components": components,
        "dependencies": [{"ref": own["bom-ref"], "dependsOn": needed}],
    }


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(sbom(), indent=1) + "\n", "utf-8")
