"""Pages of several dives and of studies, in the frame of the page of one dive."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import pandas as pd
import pytest
from made_reports import report, tables, unreferenced
from taken_apart import Document, forest_rows

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.report import Report
from insdvl_replay.document.parts import DisplayTable, Result
from insdvl_replay.document.render import save_result
from insdvl_replay.show.answers import Failure
from insdvl_replay.show.dives import index_page
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
    document = Document(
        index_page(
            [report("a b"), report("two"), Failure("three", "three.mcap: is empty")]
        ).decode()
    )
    links = [attributes["href"] for tag, attributes in document.elements if tag == "a"]
    assert links == ["a%20b/report.html", "two/report.html"] * 2, (
        "from the plot and from the table"
    )
    rows = [row.split("\n") for row in document.texts["tr"]]
    assert len(rows) == (1 + 3) + (1 + 4), "behind the dives a table of what both say together"
    assert re.findall(r"\d", document.texts["h1"][0]) == ["3", "1"]
    assert "three.mcap: is empty" in document.texts["td"]
    # On a page a number and its unit are on one line.
    cells = [text.replace("\xa0", " ") for text in document.texts["td"][:6]]
    assert cells == ["a b", "aided", "position", "1.20", "40 %", "6.7 %"], (
        "one dive has no verdict"
    )


def test_index_has_no_columns_of_which_no_dive_can_say_anything() -> None:
    alone = report(used=unreferenced(tables()))
    heads = [
        Document(index_page(outcomes).decode()).texts["tr"][0]
        for outcomes in ([alone], [alone, report("two")])
    ]
    assert "predicted" in heads[0]
    assert "position" not in heads[0]
    assert "position" in heads[1], "one dive with a reference is enough"


def dives_of_ratios(*ratios: float) -> list[Report]:
    """A dive of each ratio of the position error."""
    (position, *others), dives = tables().evidence, []
    for number, ratio in enumerate(ratios, 1):
        values = {"baseline": 1.0, "value": ratio, "ratio": ratio}
        used = msgspec.structs.replace(
            tables(), evidence=[msgspec.structs.replace(position, **values), *others]
        )
        dives.append(report(f"dive{number}", used=used))
    return dives


def test_index_starts_with_the_word_the_sentences_and_both_forests() -> None:
    document = Document(index_page(dives_of_ratios(0.82, 0.78, 0.8)).decode())
    word, against, decided, acts, _, predicted = document.texts["p"][:6]
    assert (word, against) == ("BETTER", "aided against baseline")
    assert decided == "Position 0.80 (0.75 .. 0.85), smaller on 3 of 3 dives", (
        "the word is not repeated"
    )
    assert acts.startswith("Acts: moves the track by 500 mm, 40")
    assert predicted.startswith("Predicted: 6.7")
    rows = [text for text, _ in forest_rows(document)]
    assert rows[0] == "position0.80 better 3/3"
    assert rows[-3:] == ["dive21 → 0.78 m", "dive31 → 0.8 m", "dive11 → 0.82 m"], (
        "the smallest ratio first"
    )


def test_one_dive_has_neither_word_nor_colour_nor_interval_in_a_forest() -> None:
    document = Document(index_page(dives_of_ratios(0.82, 0.78, 0.8)).decode())
    pooled, dives = forest_rows(document)[:3], forest_rows(document)[3:]
    assert [classes[1] for _, classes in pooled] == ["better"] * 3
    assert [classes[1] for _, classes in dives] == ["undecided"] * 3
    assert document.count("line", "interval") == 3


def test_index_of_two_dives_draws_no_interval_and_says_why() -> None:
    document = Document(index_page(dives_of_ratios(0.9, 0.7)).decode())
    assert forest_rows(document)[0][0] == "position0.79 undecided 2/2"
    assert any(text.startswith("A verdict takes 3 dives; ") for text in document.texts["p"])
    assert document.count("line", "interval") == 0


def test_index_of_many_dives_draws_the_largest_effects() -> None:
    document = Document(
        index_page(dives_of_ratios(*(1.0 - 0.01 * number for number in range(25)))).decode()
    )
    drawn = [text for text, _ in forest_rows(document) if text.startswith("dive")]
    assert (len(drawn), drawn[0], drawn[-1]) == (20, "dive251 → 0.76 m", "dive61 → 0.95 m")
    assert any("the 20 largest effects of 25" in title for title in document.texts["h3"])


def test_index_has_the_section_of_a_candidate_that_only_one_dive_has() -> None:
    document = Document(index_page([report("one"), Failure("two", "two.mcap: is empty")]).decode())
    word, against, statement = document.texts["p"][:3]
    assert (word, against) == ("one dive", "aided against baseline")
    assert statement.startswith("On this dive position 20.0")
    assert "Evidence on one alone" in document.texts["h3"]


def test_index_of_dives_that_are_not_evaluated_draws_no_ratio() -> None:
    dives = dives_of_ratios(0.9, 0.7)
    lost = msgspec.structs.replace(dives[0].filters["aided"], verdict="not evaluated")
    document = Document(
        index_page(
            [msgspec.structs.replace(dive, filters={"aided": lost}) for dive in dives]
        ).decode()
    )
    assert document.texts["p"][0] == "NOT EVALUATED"
    assert document.count("circle") == 0


def test_index_allows_its_own_script_alone() -> None:
    document = Document(index_page([report()]).decode())
    [policy] = [
        attributes["content"] for _, attributes in document.elements if "http-equiv" in attributes
    ]
    assert re.fullmatch(
        r"default-src 'none'; style-src 'sha256-[\w+/]{43}='; script-src 'sha256-[\w+/]{43}='",
        policy,
    )
    assert len(document.texts["script"]) == 1


@pytest.mark.nightly
def test_page_of_a_study_shows_its_findings_pictures_tables_and_losses(tmp_path: Path) -> None:
    figure = singular_value_figure("Singular values", VALUES, 1e-6)
    save_result(replace(study(), figures={"singular_values": figure}), tmp_path, png=True)
    names = {
        "singular_values.csv",
        "singular_values.svg",
        "singular_values.png",
        "config.toml",
        "report.json",
    }
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
