"""Pages of several dives and of studies, in the frame of the page of one dive."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import pandas as pd
from made_reports import report, tables, unreferenced
from taken_apart import Document, forest_rows

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.result import DisplayTable, Report, Result
from insdvl_replay.show.answers import Failure
from insdvl_replay.show.dives import index_page
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
    assert links == ["a%20b/report.html", "two/report.html"] * 2, "from the plot and from the table"
    rows = [row.split("\n") for row in document.texts["tr"]]
    assert len(rows) == (1 + 3) + (1 + 2), "behind the dives a table of what both say together"
    assert re.findall(r"\d", document.texts["h1"][0]) == ["3", "1"]
    assert "three.mcap: is empty" in document.texts["td"]
    assert document.texts["td"][:6] == ["a b", "aided", "better", "drift in 30 s", "0.80", "0.70 .. 0.90"]


def test_index_has_no_columns_of_which_no_dive_can_say_anything() -> None:
    alone = report(used=unreferenced(tables()))
    heads = [Document(index_page(outcomes).decode()).texts["tr"][0] for outcomes in ([alone], [alone, report("two")])]
    assert "verdict" in heads[0]
    assert "position" not in heads[0]
    assert "position" in heads[1], "one dive with a reference is enough"


def dives_of_ratios(*ratios: float) -> list[Report]:
    """A dive of each ratio of the drift, whose interval is a tenth to either side."""
    (drift, *others), dives = tables().evidence, []
    for number, ratio in enumerate(ratios, 1):
        values = {"baseline": 1.0, "value": ratio, "ratio": ratio, "low": 0.9 * ratio, "high": 1.1 * ratio}
        used = msgspec.structs.replace(tables(), evidence=[msgspec.structs.replace(drift, **values), *others])
        dives.append(report(f"dive{number}", used=used))
    return dives


def test_index_starts_with_the_word_the_sentence_and_both_forests() -> None:
    document = Document(index_page(dives_of_ratios(0.82, 0.78, 0.8)).decode())
    word, against, decided, predicted, counts = document.texts["p"][:5]
    assert (word, against) == ("BETTER", "aided against baseline")
    assert re.match(r"Drift in 30 s 20\.0\s% smaller on 3 of 3 dives \(95\s% interval over dives: ", decided)
    assert predicted.startswith("Predicted: 6.7")
    assert counts == "Dive by dive: 3 BETTER."
    rows = [text for text, _ in forest_rows(document)]
    assert rows[0] == "drift in 30 s0.80 better 3/3"
    assert rows[-3:] == ["dive20.78 better", "dive30.80 better", "dive10.82 better"], "the smallest ratio first"


def test_index_says_why_all_dives_decide_where_one_does_not() -> None:
    dives = []
    for found in dives_of_ratios(0.82, 0.78, 0.8):
        undecided = msgspec.structs.replace(found.filters["aided"], verdict="undecided")
        dives.append(msgspec.structs.replace(found, filters={"aided": undecided}))
    word, *_, counts = Document(index_page(dives).decode()).texts["p"][:5]
    assert (word, counts) == ("BETTER", "Dive by dive: 3 undecided (one dive may not tell, all together do).")


def test_index_of_two_dives_draws_no_interval_and_says_why() -> None:
    document = Document(index_page(dives_of_ratios(0.9, 0.7)).decode())
    (pooled, _), *dives = forest_rows(document)
    assert pooled == "drift in 30 s0.79 undecided 2/2 ¹"
    assert "¹\N{NO-BREAK SPACE}fewer than 3 dives." in document.texts["p"]
    assert document.count("line", "interval") == len(dives) == 2


def test_index_of_many_dives_draws_the_largest_effects() -> None:
    document = Document(index_page(dives_of_ratios(*(1.0 - 0.01 * number for number in range(25)))).decode())
    drawn = [text for text, _ in forest_rows(document) if text.startswith("dive")]
    assert (len(drawn), drawn[0], drawn[-1]) == (20, "dive250.76 better", "dive60.95 better")
    assert any("the 20 largest effects of 25" in title for title in document.texts["h3"])


def test_index_has_the_section_of_a_candidate_that_only_one_dive_has() -> None:
    document = Document(index_page([report("one"), Failure("two", "two.mcap: is empty")]).decode())
    assert document.texts["p"][:2] == ["BETTER", "aided against baseline"]
    assert "Evidence on one alone" in document.texts["h3"]


def test_index_of_dives_that_are_not_evaluated_draws_no_ratio() -> None:
    dives = dives_of_ratios(0.9, 0.7)
    lost = msgspec.structs.replace(dives[0].filters["aided"], verdict="not evaluated")
    document = Document(index_page([msgspec.structs.replace(dive, filters={"aided": lost}) for dive in dives]).decode())
    assert document.texts["p"][0] == "NOT EVALUATED"
    assert document.count("circle") == 0


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
