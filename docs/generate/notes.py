"""The page docs/reference/notes.md, by what the program says of its codes; `reference.py` writes it."""

from written import markdown_table

from insdvl_replay.core.notes import SOURCES, explanations


def written() -> str:
    """The page as it should be."""
    sources = " · ".join(f"`{source}`" for source in SOURCES)
    head = (
        "# Notes\n\nA note has a code in brackets, such as `[imu_gaps]`. This page lists all codes.\n"
        "`insdvl-replay explain CODE` prints the same text.\n\n"
        f"A `*` stands for a source: {sources}. In `start_*_far` it is `position` or `height`.\n\n"
        "*No candidate is evaluated* means that every verdict of this dive is *not evaluated*.\n"
    )
    return head + "".join(
        f"\n## {subject}\n\n"
        + markdown_table(
            ("code", "what happened", "effect on the results", "what to do"),
            [
                (
                    f"`{code}`",
                    *(text.replace("|", r"\|") for text in (entry.what, entry.effect, entry.cure)),
                )
                for code, entry in entries.items()
            ],
        )
        + "\n"
        for subject, entries in explanations().items()
    )
