"""Tracks as KML and GeoJSON: valid by the rules of the formats, where the vehicle was, and files of the result."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from insdvl_replay import DiveResult, load_config, read_result, replay_log
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import UserError
from insdvl_replay.show.tracks import map_of_tracks

LOG = Path(__file__).resolve().parents[2] / "examples" / "archive" / "dives" / "transit.mcap"
KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("tracks")
    assert (
        run_command_line(
            ["run", str(LOG), "-o", str(place), "--starts", "1", "--kml", "--geojson"]
        )
        == 0
    )
    return place / "transit"


def lines(geojson: str) -> dict[str, np.ndarray[Any, Any]]:
    """Read the lines, and hold them to RFC 7946."""
    found = json.loads(geojson)
    assert set(found) == {"type", "features"}
    assert found["type"] == "FeatureCollection"
    for feature in found["features"]:
        assert set(feature) == {"type", "properties", "geometry"}
        assert (feature["type"], feature["geometry"]["type"]) == ("Feature", "LineString")
        assert len(feature["geometry"]["coordinates"]) >= 2
        for place in feature["geometry"]["coordinates"]:
            assert len(place) in (2, 3)
            assert -180.0 <= place[0] <= 180.0
            assert -90.0 <= place[1] <= 90.0
    return {
        feature["properties"]["name"]: np.array(feature["geometry"]["coordinates"])
        for feature in found["features"]
    }


def test_geojson_has_each_filter_and_the_reference_with_longitude_first(folder: Path) -> None:
    found, result = lines((folder / "tracks.geojson").read_text("utf-8")), read_result(folder)
    assert list(found) == ["baseline", "aided", "reference"]
    for name, frame in {**result.histories, "reference": result.reference}.items():
        known = frame[["longitude_deg", "latitude_deg", "height_m"]].to_numpy()
        np.testing.assert_allclose(found[name][:, :2], known[:, :2], atol=1e-9)
        np.testing.assert_allclose(found[name][:, 2], known[:, 2], atol=1e-3)


def test_kml_is_that_of_the_standard(folder: Path) -> None:
    root = ElementTree.parse(folder / "tracks.kml").getroot()
    assert root.tag == f"{KML}kml"
    [document] = root
    assert [child.tag.removeprefix(KML) for child in document] == ["name", *["Placemark"] * 3]
    shown = lines((folder / "tracks.geojson").read_text("utf-8"))
    for placemark in document.iter(f"{KML}Placemark"):
        assert [child.tag.removeprefix(KML) for child in placemark] == [
            "name",
            "Style",
            "LineString",
        ]
        text = placemark.findtext(f"{KML}LineString/{KML}coordinates") or ""
        places = np.array(
            [[float(number) for number in place.split(",")] for place in text.split()]
        )
        np.testing.assert_allclose(
            places, shown[placemark.findtext(f"{KML}name") or ""], atol=1e-8
        )
        color = placemark.findtext(f"{KML}Style/{KML}LineStyle/{KML}color") or ""
        assert len(color) == 8
        assert color.startswith("ff")


def test_python_writes_the_same_from_a_folder_and_from_memory(
    folder: Path, tmp_path: Path
) -> None:
    replayed = replay_log(LOG, load_config(settings={"evaluation.starts": 1}))
    stored: DiveResult = read_result(folder)
    for ending in ("kml", "geojson"):
        made = [
            replayed.save_tracks(tmp_path / f"a.{ending}"),
            stored.save_tracks(tmp_path / f"b.{ending}"),
        ]
        assert {path.read_bytes() for path in made} == {(folder / f"tracks.{ending}").read_bytes()}
    with pytest.raises(UserError, match=r"a\.kml: exists"):
        replayed.save_tracks(tmp_path / "a.kml")
    with pytest.raises(UserError, match=r"\.kml or \.geojson"):
        replayed.save_tracks(tmp_path / "a.gpx")


def test_they_are_files_of_the_result(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["run", str(LOG), "-o", str(folder.parent), "--starts", "1"]
    assert run_command_line([*arguments, "--kml"]) == 0
    assert "unchanged" in capsys.readouterr().err
    assert run_command_line([*arguments, "--kml", "--rerun"]) == 0
    assert not (folder / "tracks.geojson").exists(), "the result is replaced as a whole"
    assert run_command_line([*arguments, "--kml", "--geojson", "--force"]) == 0
    assert "unchanged" not in capsys.readouterr().err, "what is missing is written"
    assert (folder / "tracks.geojson").exists()


def test_what_is_missing_and_hostile_names() -> None:
    frame = pd.DataFrame(
        {
            "longitude_deg": [1.0, np.nan, 2.0],
            "latitude_deg": [3.0, 3.0, 4.0],
            "height_m": [np.nan, 1.0, -2.0],
        }
    )
    none = frame.iloc[:0]
    for format_ in ("geojson", "kml"):
        text = map_of_tracks(
            format_, "<a> & \x1b b", {"aided": frame, "lost": frame.iloc[:1]}, none
        ).decode()
        if format_ == "geojson":
            assert {name: line.tolist() for name, line in lines(text).items()} == {
                "aided": [[1.0, 3.0], [2.0, 4.0]]
            }
        else:
            document = ElementTree.fromstring(text)[0]
            assert document[0].text == "<a> & \\x1b b"
            assert len(document) == 2
