"""Optional packages: what to install where one is missing.

The hint names the packages themselves, because pip finds these wherever insdvl-replay was installed from: a checkout
or a wheel. Where pipx or uv keeps it in an environment of its own, they have to put the packages there.
"""

import shlex
import sys
from importlib import metadata
from pathlib import Path
from typing import Final, Literal

Extra = Literal["cluster", "figures", "remote", "tables"]
_WITHOUT_METADATA: Final = (
    "install insdvl-replay with its extra [{extra}], in its checkout: pip install '.[{extra}]'"
)


def install_hint(extra: Extra) -> str:
    """Return the command that installs the packages of an extra, such as ``pip install 'matplotlib>=3.9'``."""
    packages = [f"'{package}'" for package in _packages(extra)]
    if not packages:
        return _WITHOUT_METADATA.format(extra=extra)
    return f"{_installer()} {' '.join(packages)}"


def _installer() -> str:
    """Return the command that installs packages into the environment of this Python."""
    if Path(sys.prefix, "pipx_metadata.json").is_file():
        return "pipx inject insdvl-replay"
    if Path(sys.prefix, "uv-receipt.toml").is_file():
        return f"uv pip install --python {shlex.quote(sys.executable)}"
    return "pip install"


def _packages(extra: Extra) -> list[str]:
    """Return the requirements of an extra as the installed package states them."""
    try:
        requirements = metadata.requires("insdvl-replay") or []
    except metadata.PackageNotFoundError:
        return []
    found = []
    for requirement in requirements:
        package, _, marker = requirement.partition(";")
        if marker.replace("'", '"').strip() == f'extra == "{extra}"':
            found.append(package.strip())
    return found
