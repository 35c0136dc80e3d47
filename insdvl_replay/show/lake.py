"""What `lake compact` shows."""

from typing import Annotated, ClassVar

from msgspec import Struct

from insdvl_replay.core.errors import counted
from insdvl_replay.core.tables import Col
from insdvl_replay.document.parts import Result
from insdvl_replay.results.lake import Compacted


class CompactedRow(Struct, frozen=True):
    """A lake that was compacted."""

    title: ClassVar = "Compacted lake"

    replays: Annotated[int, Col("Replays and rows of the lake.", head="replays")]
    rows: Annotated[int, Col(head="rows")]
    files_before: Annotated[int, Col("Files before and after.", head="files before")]
    files: Annotated[int, Col(head="files")]


def compacted_result(found: Compacted) -> Result:
    """Return what `lake compact` did."""
    replays = counted(found.replays, "replay")
    rows = counted(found.rows, "row")
    files = counted(found.files_before, "file")
    sentence = f"{replays}, {rows}: {files} before, {found.files} now"
    row = CompactedRow(found.replays, found.rows, found.files_before, found.files)
    return Result(
        kind="lake",
        title="Compacted lake",
        sentences=[sentence],
        tables={"lake": [row]},
        block="",
        document=[sentence],
    )
