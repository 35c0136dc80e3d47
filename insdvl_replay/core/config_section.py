"""What every section of the settings is made of: kinds of values, the comment beside a key, axes and stamps."""

from typing import Annotated

from msgspec import Meta, Struct

Vector = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Latency = Annotated[float, Meta(ge=-3600, le=3600)]


def Comment(comment: str) -> Meta:  # noqa: N802
    """Hold the comment that `render_toml` writes beside a key."""
    return Meta(description=comment)


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the configuration."""


AXES = 'frd | flu | a signed permutation such as "+x-y-z"; left out: by type, else frd'
STAMP = "header | log_time | publish_time | a field path; left out: by type, else header"
