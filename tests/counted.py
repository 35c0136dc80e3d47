"""Arrays that count how many elements numpy goes through: what work a function does, on any machine."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

SEARCHES = (np.searchsorted,)
"""They look at a few elements of an array, however long it is."""


class Counted(np.ndarray[Any, np.dtype[Any]]):
    """An array whose views and results count, too."""

    touched = 0

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        _count(inputs)
        return _counted(getattr(ufunc, method)(*map(_plain, inputs), **_plain(options)))

    def __array_function__(self, function: Any, _types: Any, arguments: Any, options: Any) -> Any:
        if function not in SEARCHES:
            _count(arguments)
        return _counted(function(*map(_plain, arguments), **_plain(options)))


def counted(array: NDArray[Any]) -> Counted:
    """Let an array count."""
    return array.view(Counted)


def _count(inputs: Any) -> None:
    for one in inputs:
        if isinstance(one, Counted):
            Counted.touched += one.size
        elif isinstance(one, list | tuple):
            _count(one)


def _plain(one: Any) -> Any:
    if isinstance(one, dict):
        return {name: _plain(value) for name, value in one.items()}
    if isinstance(one, list | tuple):
        return type(one)(map(_plain, one))
    return one.view(np.ndarray) if isinstance(one, Counted) else one


def _counted(result: Any) -> Any:
    return result.view(Counted) if isinstance(result, np.ndarray) else result
