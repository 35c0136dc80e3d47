"""Ways to damage dives that are tables: their columns, the text of CSV, and the bytes of any file."""

from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
from made_tables import HARMS, Tables, write_tables
from numpy.typing import NDArray

Column = NDArray[np.generic]
SHORT = (0, 1, 2, 3, 5, 12)
SHARES = (0.001, 0.08, 0.5, 0.9, 1.0)
STRANGE = (999.999, -9999.0, 1e18, 1e300, -1e300, float("inf"), 0.0, -32768.0, 5e-324)
SCALES = (1e3, 1e-3, 57.29578, 0.0174533, 9.80665, -1.0, 1.0 / 86_400.0, 1e9)
ENDINGS = ("csv", "parquet", "mat", "npz")
TEXTS = ("", "n/a", "ERR", "12 34", "1.2.3", "TRUE", "0x1f", "\u22125", "--", "1e", "9" * 400)


def _table(tables: Tables, rng: Random) -> tuple[str, dict[str, Column]]:
    name = rng.choice(
        sorted(name for name, table in tables.items() if len(next(iter(table.values()))))
    )
    return name, tables[name]


def _some_rows(count: int, rng: Random) -> NDArray[np.bool_]:
    share = rng.choice(SHARES)
    chosen = np.random.default_rng(rng.randrange(1 << 30)).random(count) < share
    chosen[rng.randrange(count)] = True
    return chosen


# --- Columns. Each takes the tables, changes one of them, and returns what it did.


def short(tables: Tables, rng: Random) -> str:
    """Keep some rows."""
    name, table = _table(tables, rng)
    count = rng.choice(SHORT)
    tables[name] = {title: column[:count] for title, column in table.items()}
    return f"{name}: {count} rows"


def no_rows_between(tables: Tables, rng: Random) -> str:
    """Keep the first and the last rows."""
    name, table = _table(tables, rng)
    count = rng.choice((1, 2, 20))
    tables[name] = {
        title: np.concatenate([column[:count], column[-count:]]) for title, column in table.items()
    }
    return f"{name}: {count} rows at each end"


def without_column(tables: Tables, rng: Random) -> str:
    """Leave a column out."""
    name, table = _table(tables, rng)
    title = rng.choice(sorted(table))
    del table[title]
    return f"{name}: without {title}"


def swapped_columns(tables: Tables, rng: Random) -> str:
    """Exchange the numbers of two columns."""
    name, table = _table(tables, rng)
    one, other = rng.sample(sorted(table), 2)
    table[one], table[other] = table[other], table[one]
    return f"{name}: {one} and {other} exchanged"


def shuffled_rows(tables: Tables, rng: Random) -> str:
    """Write the rows in another order."""
    name, table = _table(tables, rng)
    count = len(next(iter(table.values())))
    order = np.random.default_rng(rng.randrange(1 << 30)).permutation(count)
    how = rng.choice(("shuffled", "turned round", "twice", "halves exchanged"))
    if how == "turned round":
        order = np.arange(count)[::-1]
    elif how == "twice":
        order = np.repeat(np.arange(count), 2)
    elif how == "halves exchanged":
        order = np.roll(np.arange(count), count // 2)
    tables[name] = {title: column[order] for title, column in table.items()}
    return f"{name}: rows {how}"


def strange_numbers(tables: Tables, rng: Random) -> str:
    """Write a strange number into some cells."""
    name, table = _table(tables, rng)
    titles = rng.sample(sorted(table), rng.choice((1, 1, len(table))))
    rows = _some_rows(len(table[titles[0]]), rng)
    value = rng.choice((*STRANGE, float("nan")))
    for title in titles:
        table[title] = np.where(rows, value, table[title])
    return f"{name}: {value} in {int(rows.sum())} rows of {len(titles)} columns"


def scaled(tables: Tables, rng: Random) -> str:
    """Write a column, or all of a table, in another unit."""
    name, table = _table(tables, rng)
    titles = rng.choice((rng.sample(sorted(table), 1), sorted(table)))
    scale = rng.choice(SCALES)
    for title in titles:
        table[title] = table[title] * scale
    return f"{name}: {len(titles)} columns times {scale:g}"


def constant(tables: Tables, rng: Random) -> str:
    """Write the same number into all cells of a column."""
    name, table = _table(tables, rng)
    title = rng.choice(sorted(table))
    value = rng.choice((0.0, float(table[title][0])))
    table[title] = np.full(len(table[title]), value)
    return f"{name}: {title} is {value}"


def other_type(tables: Tables, rng: Random) -> str:
    """Write a column as numbers of another type."""
    name, table = _table(tables, rng)
    title = rng.choice(sorted(table))
    kind = rng.choice(("f4", "f2", "i4", "i1", "u1", "?", "i8"))
    with np.errstate(all="ignore"):
        table[title] = table[title].astype(kind)
    return f"{name}: {title} as {kind}"


def other_times(tables: Tables, rng: Random) -> str:
    """Change the times of a table."""
    name, table = _table(tables, rng)
    title = next((title for title in table if title.startswith("Time")), sorted(table)[0])
    times = table[title].astype(np.float64)
    how = rng.choice(
        ("later", "jump", "back", "coarse", "from 0", "negative", "number of the row")
    )
    step = rng.choice((1e6, 1e9, 18e9, 1e12, 1e17))
    middle = len(times) // 2
    if how == "later":
        times = times + step
    elif how == "jump":
        times[middle:] += step
    elif how == "back":
        times[middle:] -= step
    elif how == "coarse":
        times = np.floor(times / 1e9) * 1e9
    elif how == "from 0":
        times = times - times[:1].sum()
    elif how == "negative":
        times = -times
    else:
        times = np.arange(float(len(times)))
    table[title] = times
    return f"{name}: times {how}, {step:g} ns"


COLUMN_HARMS: tuple[Callable[[Tables, Random], str], ...] = (
    short, no_rows_between, without_column, swapped_columns, shuffled_rows, strange_numbers, strange_numbers, scaled,
    constant, other_type, other_times,
)  # fmt: skip


# --- Text. Each takes the text of a table and returns another.


def _cells(text: str, rng: Random, change: Callable[[str], str]) -> str:
    lines = text.split("\n")
    for _ in range(rng.choice((1, 1, 5, 100))):
        row = rng.randrange(len(lines))
        cells = lines[row].split(",")
        place = rng.randrange(len(cells))
        cells[place] = change(cells[place])
        lines[row] = ",".join(cells)
    return "\n".join(lines)


def _titles(text: str, change: Callable[[list[str]], list[str]]) -> str:
    head, _, rows = text.partition("\n")
    return "\n".join([",".join(change(head.split(","))), rows])


TEXT_HARMS: dict[str, Callable[[str, Random], str]] = {
    "texts in cells": lambda text, rng: _cells(text, rng, lambda _: rng.choice(TEXTS)),
    "quotes": lambda text, rng: _cells(text, rng, lambda cell: f'"{cell}'),
    "more cells": lambda text, rng: _cells(text, rng, lambda cell: f"{cell},{cell}"),
    "other separator": lambda text, rng: text.replace(",", rng.choice((";", "\t", "|", " ", " , ", ",,"))),
    "decimal commas": lambda text, _: text.replace(",", ";").replace(".", ","),
    "other ends of lines": lambda text, rng: text.replace("\n", rng.choice(("\r\n", "\r", "\n\n", "\n\r"))),
    "no header": lambda text, _: text.partition("\n")[2],
    "two headers": lambda text, _: "\n".join([text.partition("\n")[0], text]),
    "units below the header": lambda text, _: text.replace("\n", f"\n{'unit,' * 7}unit\n", 1),
    "a line above": lambda text, rng: rng.choice(("# made by hand\n", "log of a dive\n", "a,b\n", "sep=,\n")) + text,
    "equal titles": lambda text, _: _titles(text, lambda titles: [titles[0]] * len(titles)),
    "strange titles": lambda text, rng: _titles(
        text, lambda titles: [rng.choice(("", "[m/s]", "(((", "time", "\x00", "é" * 190, title)) for title in titles]
    ),
    "comma at the end": lambda text, _: text.replace("\n", ",\n"),
    "NUL": lambda text, rng: text[: rng.randrange(len(text))] + "\0" + text[rng.randrange(len(text)) :],
    "commented rows": lambda text, rng: text.replace("\n", "\n# ", rng.randrange(1, 50)),
}  # fmt: skip
ENCODINGS = ("utf-8-sig", "utf-16", "utf-16-le", "latin-1", "utf-32")


def harmed_text(data: bytes, rng: Random) -> tuple[str, bytes]:
    """Change a table of text."""
    text = data.decode("latin-1")
    way = rng.randrange(4)
    if way == 0:
        harm = rng.choice(HARMS)
        return harm.__name__, harm(
            text.splitlines(), np.random.default_rng(rng.randrange(1 << 30))
        ).encode()
    if way == 1 and rng.random() < 0.4:
        encoding = rng.choice(ENCODINGS)
        return encoding, text.encode(encoding)
    what = rng.choice(sorted(TEXT_HARMS))
    return what, TEXT_HARMS[what](text, rng).encode("utf-8")


# --- Bytes.


def harmed_bytes(data: bytes, rng: Random) -> tuple[str, bytes]:
    """Cut, change, remove, insert or clear bytes."""
    harmed = bytearray(data)
    place = rng.randrange(len(data))
    length = rng.choice((1, 8, 300, 5000))
    way = rng.choice(("cut", "changed", "removed", "inserted", "cleared", "twice", "cut to a few"))
    if way == "cut":
        del harmed[place:]
    elif way == "cut to a few":
        del harmed[rng.randrange(1, 200) :]
    elif way == "changed":
        for at in rng.choices(range(len(data)), k=rng.choice((1, 1, 20))):
            harmed[at] = rng.randrange(256)
    elif way == "removed":
        del harmed[place : place + length]
    elif way == "inserted":
        harmed[place:place] = rng.randbytes(length)
    elif way == "cleared":
        harmed[place : place + length] = bytes(len(harmed[place : place + length]))
    else:
        harmed += data
    return f"bytes {way}", bytes(harmed)


def written(tables: Tables, folder: Path, ending: str, rng: Random | None) -> tuple[str, Path]:
    """Write tables, damaged in one or two ways if there is a generator; return what was done, and what to read."""
    done: list[str] = []
    tables = {name: dict(table) for name, table in tables.items()}
    kind = (
        rng.choice(("columns", "columns", "text" if ending == "csv" else "columns", "bytes"))
        if rng
        else ""
    )
    for _ in range(rng.choice((1, 1, 2)) if rng and kind == "columns" else 0):
        done.append(rng.choice(COLUMN_HARMS)(tables, rng))
    path, _ = write_tables(folder, tables, ending)
    if rng and kind in ("text", "bytes"):
        file = rng.choice(sorted(folder.iterdir()))
        harm = harmed_text if kind == "text" else harmed_bytes
        what, data = harm(file.read_bytes(), rng)
        file.write_bytes(data)
        done.append(f"{file.name}: {what}")
    return " + ".join(done), path
