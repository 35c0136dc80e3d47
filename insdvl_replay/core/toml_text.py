"""TOML as text into tables, where every reason why it cannot be is told in one way."""

import tomllib
from typing import Any


def parsed_toml(text: str) -> dict[str, Any]:
    """Read TOML.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict

    Raises
    ------
    tomllib.TOMLDecodeError
        It is not valid, or has more digits or brackets than Python reads.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise tomllib.TOMLDecodeError("Too many brackets inside each other") from error
    except ValueError as error:
        raise tomllib.TOMLDecodeError("A number has too many digits") from error
