"""`history`: the versions in a lake, and the step where a filter changed."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from made_lakes import digest, replayed
from msgspec.structs import replace

from insdvl_replay.core.errors import ConfigError, ResultError
from insdvl_replay.core.report import CodeFile, Report
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.document.parts import Callout, Figure
from insdvl_replay.document.render import document, render
from insdvl_replay.results.lake import LakeWriter, require_lake
from insdvl_replay.show.history import StepRow, VersionRow, history_result, read_histories

pytest.importorskip("pyarrow", reason="needs pyarrow")
VERSIONS = 6
DIVES = 12


def replay(
    dive: int,
    ratio: float,
    *,
    version: int = 0,
    settings: str = "old",
    code: str = "",
    quantity: str = "position",
    verdict: str = Verdict.UNDECIDED,
) -> Report:
    """Return the report of a dive with a ratio of its primary quantity."""
    name = f"dive {dive}"
    row = EvidenceRow(name, "aided", "track", quantity, "m", 1.0, ratio, ratio, role=Role.PRIMARY)
    made = replayed(name, settings, rows=[row], verdict=verdict)
    started_at = f"2026-0{version + 1}-01T00:00:{dive:02d}+00:00"
    made = replace(made, tool=replace(made.tool, started_at=started_at))
    if code:
        made = replace(made, code={"own:Filter": CodeFile("own.py", digest(code))})
    return made


def ratios_of(seed: int, factors: list[float]) -> np.ndarray:
    """Return the ratio of each version on each dive."""
    rng = np.random.default_rng(seed)
    of_dives = rng.normal(-0.2, 0.3, DIVES)
    jitter = rng.normal(0.0, 0.03, (len(factors), DIVES))
    return np.exp(of_dives + jitter) * np.array(factors)[:, None]


@pytest.fixture
def lake(tmp_path: Path) -> Path:
    """Six versions by name, of which the fourth has other settings and is 20 % worse."""
    folder = tmp_path / "lake"
    require_lake(folder, ())
    for version, ratios in enumerate(ratios_of(1, [1.0] * 3 + [1.2] * 3)):
        writer = LakeWriter(folder, f"v1.{version}")
        settings = "new" if version >= 3 else "old"
        for dive, ratio in enumerate(ratios.tolist()):
            writer.add(replay(dive, ratio, version=version, settings=settings))
        writer.close()
    return folder


def test_the_planted_step_is_named(lake: Path) -> None:
    result = history_result(lake)
    (row,) = [StepRow(*cells) for cells in result.tables["step"].rows]
    assert (row.filter, row.quantity, row.verdict) == ("aided", "position", "worse")
    assert (row.name, row.started_at[:10]) == ("v1.3", "2026-04-01")
    assert (row.against, row.against_started_at[:10]) == ("v1.0", "2026-01-01")
    assert (row.seen_at, row.changed, row.dives) == ("v1.3", "settings", DIVES)
    assert row.change == pytest.approx(1.2, rel=0.03)
    assert 1.05 < row.low < row.change < row.high
    assert row.ratio_to / row.ratio_from == pytest.approx(row.change)
    (sentence,) = result.sentences
    assert isinstance(sentence, Callout)
    assert sentence.tone == "bad"
    for word in ("v1.3", "2026-04-01", "v1.0", "settings"):
        assert word in sentence.text


def test_each_version_has_a_row(lake: Path) -> None:
    rows = [VersionRow(*cells) for cells in history_result(lake).tables["version"].rows]
    assert [row.name for row in rows] == [f"v1.{number}" for number in range(VERSIONS)]
    assert [row.number for row in rows] == [1, 2, 3, 4, 5, 6]
    expected = ratios_of(1, [1.0] * 3 + [1.2] * 3)
    for row, ratios in zip(rows, expected, strict=True):
        assert row.ratio == pytest.approx(math.exp(np.log(ratios).mean()))
        assert row.low < row.ratio < row.high
        assert row.dives == DIVES
    assert [row.against for row in rows] == ["", *["v1.0"] * 3, *["v1.3"] * 2]
    assert {row.settings_sha256 for row in rows[:3]} == {digest("old")}
    assert {row.settings_sha256 for row in rows[3:]} == {digest("new")}


def test_six_equal_versions_have_no_step(tmp_path: Path) -> None:
    require_lake(tmp_path / "lake", ())
    for version, ratios in enumerate(ratios_of(2, [1.0] * 6)):
        writer = LakeWriter(tmp_path / "lake", f"v1.{version}")
        for dive, ratio in enumerate(ratios.tolist()):
            writer.add(replay(dive, ratio, version=version))
    result = history_result(tmp_path / "lake")
    assert not list(result.tables["step"].rows)
    assert "step" not in {getattr(part, "title", "") for part in document(result)}


def test_without_names_a_version_is_its_settings_and_code(tmp_path: Path) -> None:
    require_lake(tmp_path / "lake", ())
    writer = LakeWriter(tmp_path / "lake")
    for version, (settings, code) in enumerate((("old", ""), ("new", ""), ("new", "mine"))):
        for dive in range(3):
            writer.add(replay(dive, 0.9, version=version, settings=settings, code=code))
    (found,), left_out = read_histories(tmp_path / "lake")
    assert not left_out
    old, new, mine = digest("old")[:8], digest("new")[:8], digest("mine")[:8]
    assert [*found.known] == [f"0.1.0 {old}", f"0.1.0 {new}", f"0.1.0 {new} {mine}"]


def test_named_versions_leave_out_others_and_say_so(lake: Path) -> None:
    writer = LakeWriter(lake)
    for dive in range(4):
        writer.add(replay(dive, 5.0, settings="tried"))
    (found,), left_out = read_histories(lake)
    assert len(found.known) == VERSIONS
    assert "4 replays" in left_out
    assert left_out in [part for part in document(history_result(lake)) if isinstance(part, str)]


def test_the_latest_replay_of_a_version_counts_and_one_that_is_not_evaluated_does_not(
    tmp_path: Path,
) -> None:
    require_lake(tmp_path / "lake", ())
    writer = LakeWriter(tmp_path / "lake", "v1")
    for dive in range(4):
        writer.add(replay(dive, 0.5, version=0, settings="old"))
        writer.add(replay(dive, 0.8, version=1, settings="new"))
    writer.add(replay(9, 99.0, verdict=Verdict.NOT_EVALUATED))
    (found,), _ = read_histories(tmp_path / "lake")
    (version,) = found.history.versions
    assert version.interval.ratio == pytest.approx(0.8)
    assert version.interval.dives == 4
    assert found.known["v1"].identity["settings_sha256"] == digest("new")


def test_a_quantity_is_chosen_by_the_dives_or_by_name(tmp_path: Path) -> None:
    require_lake(tmp_path / "lake", ())
    writer = LakeWriter(tmp_path / "lake", "v1")
    for dive in range(4):
        writer.add(replay(dive, 0.9, quantity="outage_30s"))
    assert read_histories(tmp_path / "lake")[0][0].quantity == "outage_30s"
    with pytest.raises(ResultError, match="has no ratio of drift in 30 s"):
        history_result(tmp_path / "lake", "drift_30s")
    with pytest.raises(ConfigError, match="quantity 'positon' is not known"):
        history_result(tmp_path / "lake", "positon")


def test_it_has_a_page_a_table_and_json(lake: Path) -> None:
    result = history_result(lake)
    page = render(result, "html")
    assert page.count("<svg") >= 1
    assert "v1.3" in page
    (figure,) = [part for part in document(result) if isinstance(part, Figure)]
    (panel,) = figure.panels
    (step,) = [curve for curve in panel.curves if curve.name == "step"]
    assert step.x.tolist() == [4.0]
    table = render(result, "csv")
    assert len(table.splitlines()) == 2 + 1 + 1 + VERSIONS
    content = json.loads(render(result, "json"))
    assert content["kind"] == "history"
    assert [row["name"] for row in content["tables"]["step"]] == ["v1.3"]


def test_replays_without_an_evaluation_are_counted_with_the_reason(tmp_path: Path) -> None:
    folder = tmp_path / "lake"
    require_lake(folder, ())
    writer = LakeWriter(folder, "v1.0")
    for dive in range(4):
        writer.add(replay(dive, 1.0, verdict=Verdict.NOT_EVALUATED))
    writer.close()
    with pytest.raises(ResultError) as caught:
        history_result(folder)
    assert f"4 replays with filters that are {Verdict.NOT_EVALUATED}" in str(caught.value)
    assert "--lake" in caught.value.hint


def test_a_step_has_the_key_of_its_point(lake: Path) -> None:
    page = render(history_result(lake), "html")
    assert re.search(r'<path class="points [^"]*reached" d="M20 5h0"/></svg>step', page)
    assert re.search(r'<path class="line limit" d="M1 5H39"/></svg>band of 5 %', page)
