"""The picture of how data flow from a log to the verdict, with the file of each step."""

from html import escape
from typing import NamedTuple

from written import PROJECT

PACKAGE = PROJECT / "insdvl_replay"
WIDTH = 960
HEIGHT = 372
BOX_WIDTH = 168
BOX_HEIGHT = 44
# Left ends of the columns, and the tops of the rows.
COLUMNS = (12, 204, 396, 588, 780)
ROWS = (16, 84, 152, 220, 288)
DATA = "#e8eef8"
STEP = "#f3f4f6"
ANSWER = "#e7f4ea"


class Box(NamedTuple):
    """A kind of data, or a step."""

    column: int
    row: int
    text: str
    file: str = ""  # of the package, that does it
    colour: str = STEP


BOXES = {
    "imu": Box(0, 0, "IMU", "logs/columns/imu.py", DATA),
    "beams": Box(0, 2, "beams of the DVL", "logs/columns/dvl.py", DATA),
    "reference": Box(0, 4, "reference", "logs/columns/reference.py", DATA),
    "velocity": Box(1, 2, "velocity", "nav/dvl.py"),
    "acceleration": Box(1, 3, "acceleration", "nav/dvl.py"),
    "baseline": Box(2, 0, "baseline", "nav/filter.py"),
    "aided": Box(2, 2, "candidate", "nav/filter.py"),
    "outages": Box(3, 1, "drift in DVL outages", "evaluation/outage_test.py"),
    "errors": Box(3, 3, "errors, same starts", "evaluation/reference_errors.py"),
    "sigma": Box(3, 0, "predicted sigma", "evaluation/convergence.py"),
    "ratio": Box(4, 2, "ratio and interval", "evaluation/interval.py"),
    "verdict": Box(4, 3, "verdict", "evaluation/verdicts.py", ANSWER),
    "confirmed": Box(4, 0, "confirmed or not", "evaluation/answers.py", ANSWER),
}
ARROWS = (
    ("imu", "baseline"),
    ("imu", "aided"),
    ("beams", "velocity"),
    ("velocity", "acceleration"),
    ("velocity", "baseline"),
    ("velocity", "aided"),
    ("acceleration", "aided"),
    ("baseline", "sigma"),
    ("aided", "sigma"),
    ("baseline", "outages"),
    ("aided", "outages"),
    ("baseline", "errors"),
    ("aided", "errors"),
    ("reference", "errors"),
    ("outages", "ratio"),
    ("errors", "ratio"),
    ("ratio", "verdict"),
    ("sigma", "confirmed"),
    ("ratio", "confirmed"),
)


def flow_picture() -> bytes:
    """Draw the boxes and the arrows between them."""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        'font-size="13">',
        '<defs><marker id="end" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0 L8 4 L0 8 z" fill="#6b7280"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
    ]
    lines += [_arrow(BOXES[start], BOXES[end]) for start, end in ARROWS]
    for box in BOXES.values():
        lines += _box(box)
    lines.append(
        f'<text x="{COLUMNS[0]}" y="{HEIGHT - 14}" fill="#4b5563">The steps of the baseline and the candidate are the '
        "same, but for one change. Grey: the file of each step in insdvl_replay.</text>"
    )
    return "\n".join([*lines, "</svg>", ""]).encode()


def _box(box: Box) -> list[str]:
    left = COLUMNS[box.column]
    top = ROWS[box.row]
    middle = left + BOX_WIDTH // 2
    if not (PACKAGE / box.file).is_file():
        raise FileNotFoundError(f"{box.text}: insdvl_replay/{box.file} does not exist")
    return [
        f'<rect x="{left}" y="{top}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="5" fill="{box.colour}" '
        'stroke="#9ca3af"/>',
        f'<text x="{middle}" y="{top + 18}" text-anchor="middle">{escape(box.text)}</text>',
        f'<text x="{middle}" y="{top + 35}" text-anchor="middle" font-size="10" fill="#6b7280">{box.file}</text>',
    ]


def _arrow(start: Box, end: Box) -> str:
    if start.column == end.column:
        x1 = COLUMNS[start.column] + BOX_WIDTH // 2
        x2 = x1
        y1 = ROWS[start.row]
        y2 = ROWS[end.row] + BOX_HEIGHT
        if start.row < end.row:
            y1 = ROWS[start.row] + BOX_HEIGHT
            y2 = ROWS[end.row]
    else:
        x1 = COLUMNS[start.column] + BOX_WIDTH
        x2 = COLUMNS[end.column]
        y1 = ROWS[start.row] + BOX_HEIGHT // 2
        y2 = ROWS[end.row] + BOX_HEIGHT // 2
    return (
        f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="#6b7280" stroke-width="1.2" '
        'marker-end="url(#end)"/>'
    )
