"""URLs of logs: which are fetched, and how they are shown without what gives access to them."""

import re
from typing import Final
from urllib.parse import SplitResult, quote, unquote, urlsplit

FETCHED: Final = ("https", "http", "s3", "gs", "file")
_URL: Final = re.compile(r"\b[A-Za-z][\w+.-]*://[^\s'\"<>`;]+")


def url_parts(url: str) -> SplitResult | None:
    """Return the parts of a URL whose log can be fetched, by its scheme; None for any other text.

    Chains of fsspec (``zip::https://...``) and all its other schemes would let a list open any file in any way.
    """
    try:
        parts = urlsplit(url)
        _ = parts.port  # a password with a slash looks like one
    except ValueError:
        return None
    is_chain = "::" in url.replace(parts.netloc, "", 1) or (
        "::" in parts.netloc and "[" not in parts.netloc
    )
    if is_chain or parts.scheme not in FETCHED or not (parts.netloc or parts.path):
        return None
    return parts


def shown_url(url: str) -> str:
    """Return a URL without user, password, query and fragment, as it is printed and stored."""
    scheme, mark, rest = url.partition("://")
    place, asks, _ = rest.partition("?")
    place = place.partition("#")[0]
    authority = place.partition("/")[0]
    is_port = authority.rpartition(":")[2].isdecimal()
    if "@" in authority:
        place = authority.rpartition("@")[2] + place[len(authority) :]
    elif "@" in place and ":" in authority and not is_port:  # a password with a slash
        place = place.rpartition("@")[2]
    return f"{scheme}{mark}{place}{'?...' if asks else ''}"


def without_access(text: str, url: str = "") -> str:
    """Return a text whose URLs are shown, above all a known one and its parts."""
    if url:
        text = text.replace(url, shown_url(url)).replace(quote(url), shown_url(url))
        for secret in _secrets(url):
            text = text.replace(secret, "...")
    if "://" in text:
        return _URL.sub(_shown, text)
    return text


def _shown(found: re.Match[str]) -> str:
    url = found[0].rstrip(":,)")  # of the sentence
    return f"{shown_url(url)}{found[0][len(url) :]}"


def _secrets(url: str) -> list[str]:
    """Return the parts of a URL that may give access, the longest first."""
    _, _, rest = url.partition("://")
    place, _, query = rest.partition("?")
    login = place.rpartition("@")[0]
    found = {query, login, login.partition(":")[2]}
    for part in re.split("[&#]", query):
        found |= {part, part.partition("=")[2]}
    found |= {unquote(one) for one in found}
    return sorted((one for one in found if len(one) > 2), key=len, reverse=True)
