"""The old place of these names."""

from insdvl_replay.core.result import *  # noqa: F403
from insdvl_replay.core.result import as_json as encode_report

__all__ = ["encode_report"]
