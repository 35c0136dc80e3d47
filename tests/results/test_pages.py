"""Pages of several dives and of studies, in the frame of the page of one dive."""

import re
from dataclasses import replace
from pathlib import Path

import pandas as pd
from made_reports import report, tables, unreferenced
from taken_apart import Document

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.result import DisplayTable, Result
from insdvl_replay.show.dives import Failure, index_page
from insdvl_replay.show.render import save_result
from insdvl_replay.studies.observability import singular_value_figure

VALUES = pd.DataFrame(
    [(aiding, number, 5.0 / number) for aiding in "abcde" for number in range(1, 13)],
    columns=["aiding", "number", "singular_value"],
)


def study() -> Result:
    return Result(
        kind="observability",
        title="Observability study: <straight>",
        arguments={"dive": "straight", "earth_rate": True},
        sentences=("rank 9 of 12", "rank 6 of 12"),
        tables={"singular_values": VALUES},
        display=(DisplayTable("Ranks", ("aiding", "rank"), "lr", (("velocity", "9"),)),),
        config=Config(),
        notes=(Note("imu_gaps", "the IMU pauses 3 times", 3, "warning"),),
    )


def test_index_leads_to_every_dive_and_says_why_one_failed() -> None:
    document = Document(index_page([report("a b"), report("two"), Failure("three", "three.mcap: is empty")]).decode())
    links = [attributes["href"] for tag, attributes in document.elements if tag == "a"]
    assert links == ["a%20b/report.html", "two/report.html"]
    rows = [row.split("\n") for row in document.texts["tr"]]
    assert len(rows) == (1 + 3) + (1 + 2), "behind the dives a table of what both say together"
    assert re.findall(r"\d", document.texts["h1"][0]) == ["3", "1"]
    assert "three.mcap: is empty" in document.texts["td"]
    assert document.texts["td"][:4] == ["a b", "aided", "better", "20.0 %"]


def test_index_has_no_columns_of_which_no_dive_can_say_anything() -> None:
    alone = report(used=unreferenced(tables()))
    heads = [Document(index_page(outcomes).decode()).texts["tr"][0] for outcomes in ([alone], [alone, report("two")])]
    assert "measured" in heads[0]
    assert "position" not in heads[0]
    assert "position" in heads[1], "one dive with a reference is enough"


def test_index_allows_its_own_script_alone() -> None:
    document = Document(index_page([report()]).decode())
    [policy] = [attributes["content"] for _, attributes in document.elements if "http-equiv" in attributes]
    assert re.fullmatch(r"default-src 'none'; style-src 'sha256-[\w+/]{43}='; script-src 'sha256-[\w+/]{43}='", policy)
    assert len(document.texts["script"]) == 1


def test_page_of_a_study_shows_its_findings_pictures_tables_and_losses(tmp_path: Path) -> None:
    figure = singular_value_figure("Singular values", VALUES, 1e-6)
    save_result(replace(study(), figures={"singular_values": figure}), tmp_path, png=True)
    names = {"singular_values.csv", "singular_values.svg", "singular_values.png", "config.toml", "report.json"}
    assert {path.name for path in tmp_path.iterdir()} == names | {"report.html"}
    document = Document((tmp_path / "report.html").read_text("utf-8"))
    assert document.texts["p"][:2] == ["rank 9 of 12", "rank 6 of 12"]
    assert document.texts["h1"][0].endswith(": <straight>")
    assert document.count("figure") == 1
    assert document.count("path", "filter4") > 0
    assert {"velocity", "9", "the IMU pauses 3 times [imu_gaps]"} <= set(document.texts["td"])
    assert {"straight", "True"} <= set(document.texts["dd"])


def test_study_without_pictures_has_a_page_and_the_same_bytes(tmp_path: Path) -> None:
    pages = []
    for name in ("once", "again"):
        (tmp_path / name).mkdir()
        save_result(study(), tmp_path / name)
        pages.append((tmp_path / name / "report.html").read_bytes())
    assert pages[0] == pages[1]
