"""A result in any format, and the files of its folder."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from insdvl_replay.core.config_file import render_toml
from insdvl_replay.core.report import (
    Tool,
    as_json,
    package_versions,
    this_tool,
)
from insdvl_replay.document.parts import (
    PAGE,
    Callout,
    Document,
    Heading,
    Only,
    Part,
    Result,
    ResultJson,
    Title,
)
from insdvl_replay.document.tables import (
    blocks_csv,
    header_and_rows,
    notes_table,
    rows_csv,
    shown,
    table_csv,
)
from insdvl_replay.document.text import as_markdown, sentence_of


def render(result: Result, format_: str) -> str:
    """Write a result as json, csv, md, latex or html."""
    match format_:
        case "json":
            return result_json(result).decode()
        case "csv":
            blocks = {name: header_and_rows(table) for name, table in result.tables.items()}
            if result.block:
                return blocks_csv(result.block, blocks)
            return rows_csv(*next(iter(blocks.values())))
        case "md":
            return as_markdown(document(result))
        case "latex":
            from insdvl_replay.document.latex import as_latex

            is_of_dives = result.kind in ("replay", "inspection")
            return as_latex(document(result), result.title if is_of_dives else "")
        case "html":
            from insdvl_replay.document.page import page

            return page(document(result)).decode()
    raise ValueError(f"{format_} is no format")


def document(result: Result) -> Document:
    """Return the parts of a result in their order."""
    if result.document is not None:
        return result.document
    parts: list[Part] = [Title(result.title)]
    for sentence in result.sentences:
        parts.append(Callout(sentence) if isinstance(sentence, str) else sentence)
    if result.figures:
        parts += [Heading("Figures"), *result.figures.values()]
    parts += [Heading("Tables"), *(result.display or _tables_by_type(result))]
    last = (Heading("Notes"), notes_table(result.notes), *_provenance(result))
    return [*parts, Only(PAGE, last)]


def _tables_by_type(result: Result) -> Iterator[Part]:
    """Yield the tables whose row types say how they are shown."""
    for table in result.tables.values():
        if isinstance(table, Sequence) and table and hasattr(table[0], "title"):
            yield shown(type(table[0]), table)


def _provenance(result: Result) -> list[Part]:
    from insdvl_replay.document.page import facts, settings_details

    named = {}
    for name, value in result.arguments.items():
        values = value if isinstance(value, list) else [value]
        named[name] = ", ".join(map(str, values))
    versions = [f"{name} {version}" for name, version in package_versions().items()]
    named["tool"] = f"{Tool().name} {Tool().version}"
    named["packages"] = ", ".join(versions)
    parts: list[Part] = [Heading("Provenance"), facts(named)]
    if result.config:
        parts.append(settings_details(render_toml(result.config)))
    return parts


def result_json(result: Result) -> bytes:
    """Write a result as JSON; missing values are null. The same result gives the same bytes."""
    if result.data is not None:
        return as_json(result.data)
    return as_json(
        ResultJson(
            tool=this_tool(),
            versions=package_versions(),
            kind=result.kind,
            title=result.title,
            arguments=dict(result.arguments),
            facts=dict(result.facts),
            sentences=[sentence_of(part) for part in result.sentences],
            tables={name: _records(table) for name, table in result.tables.items()},
            notes=list(result.notes),
            config=msgspec.to_builtins(result.config) if result.config else {},
        )
    )


def _records(table: Any) -> list[dict[str, Any]]:
    header, rows = header_and_rows(table)
    columns = [str(column) for column in header]
    return [dict(zip(columns, row, strict=True)) for row in rows]


def result_schema(tables: Mapping[str, type[Struct]]) -> dict[str, Any]:
    """Describe the JSON of a result by the row types of its tables, as JSON schema."""
    (result, *rows), definitions = msgspec.json.schema_components(
        [ResultJson, *tables.values()], ref_template="#/$defs/{name}"
    )
    properties = {}
    for name, row in zip(tables, rows, strict=True):
        properties[name] = {"type": "array", "items": row}
    definitions[ResultJson.__name__]["properties"]["tables"]["properties"] = properties
    return {**result, "$defs": definitions}


def save_result(result: Result, folder: Path, *, png: bool = False) -> None:
    """Write figures, tables, settings, the page and, last, the file by which a result is known, into a folder."""
    # Imported here, since the schema must not wait for numpy.
    from insdvl_replay.document.page import page
    from insdvl_replay.document.plot import sheet_svg

    for name, figure in result.figures.items():
        (folder / f"{name}.svg").write_bytes(sheet_svg(figure))
        if png:
            from insdvl_replay.document.paper import figure_png

            (folder / f"{name}.png").write_bytes(figure_png(figure))
    for name, table in {**result.tables, **result.series}.items():
        (folder / f"{name}.csv").write_bytes(table_csv(table))
    if result.config is not None:
        (folder / "config.toml").write_text(render_toml(result.config), "utf-8")
    if result.settings:
        (folder / "proposed.toml").write_text(result.settings, "utf-8")
    (folder / "report.html").write_bytes(page(document(result)))
    (folder / "report.json").write_bytes(result_json(result))
