"""The version of the package, as its results, its logs and its commands state it."""

__version__ = "0.1.0"
