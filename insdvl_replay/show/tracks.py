"""The tracks of a replay for other tools: TUM for evo, GeoJSON and KML for maps."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.errors import visible
from insdvl_replay.document.looks import strokes
from insdvl_replay.document.parts import REFERENCE, filter_style
from insdvl_replay.geometry.frames import east_north_up_m, quat_enu_flu
from insdvl_replay.preparation.replay import Replay
from insdvl_replay.results.folder import MAPS, REFERENCE_TRAJECTORY, trajectory_file
from insdvl_replay.results.frames import history_frame, reference_frame

if TYPE_CHECKING:
    import pandas as pd

TUM: Final = "tum"
# Decimals of a degree, the last of which is 0.1 mm, and of a metre.
_DIGITS = 9
_HEIGHT_DIGITS = 3


def save_tracks(replay: Replay, folder: Path, formats: Sequence[str]) -> None:
    """Write the tracks of all filters, and of the reference inside the replay, if its positions are known."""
    origin = replay.histories[0].position[0]  # All count from where the baseline starts.
    if TUM in formats:
        for history in replay.histories:
            text = tum_trajectory(history.time_ns, history.position, history.mat_nb, origin)
            (folder / trajectory_file(history.filter)).write_bytes(text)
        if replay.dive.reference is not None:
            inside = replay.dive.reference.within(replay.start_ns, replay.end_ns)
            if text := tum_trajectory(inside.time_ns, inside.position, inside.mat_nb, origin):
                (folder / REFERENCE_TRAJECTORY).write_bytes(text)
    maps = [format_ for format_ in formats if format_ in MAPS]
    if maps:
        frames = {history.filter: history_frame(history) for history in replay.histories}
        reference = reference_frame(replay.dive.reference, replay.start_ns, replay.end_ns, origin)
        for format_ in maps:
            (folder / MAPS[format_]).write_bytes(
                map_of_tracks(format_, replay.dive.name, frames, reference)
            )


# --- TUM.


def tum_trajectory(
    time_ns: TimeNs,  # (k,)
    position: Floats,  # (k, 3): latitude rad, longitude rad, height m
    mat_nb: Floats,  # (k, 3, 3); NaN where no attitude is known
    origin: Floats,  # (3,): from which east, north and up are counted
) -> bytes:
    """Write a trajectory as TUM: times to the nanosecond; forward-port-up to east-north-up.

    The format knows no missing positions: times without one have no line. A missing attitude is NaN, which evo takes
    where it compares positions.
    """
    known = np.isfinite(position).all(axis=1)
    columns = np.hstack([east_north_up_m(position[known], origin), quat_enu_flu(mat_nb[known])])
    lines = []
    for time, row in zip(time_ns[known].tolist(), columns.tolist(), strict=True):
        second, nanosecond = divmod(time, NS_PER_S)
        numbers = " ".join(f"{number:.9g}" for number in row)
        lines.append(f"{second}.{nanosecond:09d} {numbers}\n")
    return "".join(lines).encode()


# --- Maps: longitude before latitude in degrees of WGS 84, and the height above its ellipsoid.


def map_of_tracks(
    format_: str,
    dive: str,
    frames: Mapping[str, "pd.DataFrame"],
    reference: "pd.DataFrame",
) -> bytes:
    """Write tracks as lines, by name, from frames of histories and of the reference."""
    named = [(name, "filter", frame) for name, frame in frames.items()]
    named.append((REFERENCE, REFERENCE, reference))
    lines = []
    for name, kind, frame in named:
        positions = _positions(frame)
        if len(positions) > 1:
            lines.append(_Line(name, kind, positions))
    if format_ == "geojson":
        return _geojson(dive, lines)
    return _kml(dive, lines)


def _positions(frame: "pd.DataFrame") -> list[list[float]]:
    """Return the known positions of a line, without heights if one is missing."""
    known = frame[["longitude_deg", "latitude_deg", "height_m"]].to_numpy()
    known = known[np.isfinite(known[:, :2]).all(axis=1)]
    columns = [np.round(known[:, :2], _DIGITS)]
    if np.isfinite(known[:, 2]).all():
        columns.append(np.round(known[:, 2:], _HEIGHT_DIGITS))
    line: list[list[float]] = np.hstack(columns).tolist()
    return line


class _Line(NamedTuple):
    """A track as a line."""

    name: str
    kind: str  # filter or reference
    positions: list[list[float]]


def _geojson(dive: str, lines: Sequence[_Line]) -> bytes:
    """Write a FeatureCollection of RFC 7946."""
    features: list[dict[str, Any]] = [
        {
            "type": "Feature",
            "properties": {"name": name, "kind": kind, "dive": dive},
            "geometry": {"type": "LineString", "coordinates": line},
        }
        for name, kind, line in lines
    ]
    return (
        json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False).encode()
        + b"\n"
    )


def _kml(dive: str, lines: Sequence[_Line]) -> bytes:
    """Write a document of KML 2.2; programs draw its lines at the surface, so that water does not hide them."""
    places = []
    for number, (name, kind, line) in enumerate(lines):
        style = REFERENCE if kind == REFERENCE else filter_style(number)
        coordinates = " ".join(_kml_place(place) for place in line)
        places.append(
            f"<Placemark><name>{escape(visible(name))}</name><Style><LineStyle><color>{_kml_colour(style)}</color>"
            "<width>2</width></LineStyle></Style><LineString><tessellate>1</tessellate>"
            f"<coordinates>{coordinates}</coordinates></LineString></Placemark>\n"
        )
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
    return f"{head}<name>{escape(visible(dive))}</name>\n{''.join(places)}</Document></kml>\n".encode()


def _kml_place(place: Sequence[float]) -> str:
    """Write the numbers of a place, without zeros at their ends."""
    numbers = [f"{value:.{_DIGITS}f}" for value in place]
    return ",".join(number.rstrip("0").rstrip(".") for number in numbers)


def _kml_colour(style: str) -> str:
    """Write the colour of a style as opacity, blue, green and red."""
    colour = strokes()[style].colour or "#000000"
    return f"ff{colour[5:7]}{colour[3:5]}{colour[1:3]}"
