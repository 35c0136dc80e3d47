"""What this program is made of, as a digest: a development installation changes without its version."""

import hashlib
from functools import cache
from pathlib import Path
from typing import Final

EVERYTHING: Final = ("**/*",)


@cache
def sources_digest(patterns: tuple[str, ...] = EVERYTHING) -> str:
    """Digest files of the package, by name and content.

    Parameters
    ----------
    patterns : tuple of str
        Which, seen from the package's folder; all of them unless said otherwise. What Python compiles of them does not
        count.

    Returns
    -------
    str
        SHA-256, of which 16 hexadecimal digits.
    """
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted({path for pattern in patterns for path in package.glob(pattern)}):
        if path.is_file() and path.parent.name != "__pycache__":
            digest.update(f"{path.relative_to(package).as_posix()}\0{path.stat().st_size}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
