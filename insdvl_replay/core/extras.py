"""Optional packages: what to install where one is missing.

The hint names the packages themselves, because pip finds these wherever insdvl-replay was installed from: a checkout,
a wheel or a package index.
"""

from importlib import metadata
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
    return f"pip install {' '.join(packages)}"


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
