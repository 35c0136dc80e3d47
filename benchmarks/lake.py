"""How long the queries of docs/lake.md take on a lake of a million rows, before and after `lake compact`.

The lake has the evidence of a thousand dives, each replayed by forty versions. Files of single replays are measured on
a thirtieth of them. It is made in a temporary folder, which is removed in the end. `make bench` runs it.
"""

import ast
import os
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from results import machine, table, write_part

from insdvl_replay.core.tables import LAKE
from insdvl_replay.results.lake import ROWS, compact_lake, require_lake

PAGE = Path(__file__).resolve().parents[1] / "docs" / "lake.md"
TITLES = re.compile(r"^## (.+)$", re.MULTILINE)
QUERY = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DIVES = 1000
VERSIONS = 40
QUANTITIES = ("position", "position_end", "drift_30s", "drift_60s", "drift_100m", "heading", "roll", "pitch",
              "velocity_along", "velocity_across", "outage_30s", "outage_60s")  # fmt: skip
FILTERS = ("aided", "windowed")
FILES_MEASURED = 1333
ROUNDS = 3
ALLOWED_S = 1.0


class Took(NamedTuple):
    """What a query took."""

    wall_s: float
    processor_s: float


def evidence(dive: int, version: int, rng: np.random.Generator) -> dict[str, list[object]]:
    """Return the rows of a replay, by column."""
    count = len(QUANTITIES) * len(FILTERS) + 1
    ratios = np.exp(rng.normal(-0.1, 0.2, count))
    hexes = {name: f"{number:064x}" for name, number in (("log", dive), ("settings", version))}
    same = {
        "log": f"dive_{dive:04d}",
        "evidence": "accuracy",
        "unit": "m",
        "filter_verdict": "undecided",
        "vehicle": f"vehicle_{dive % 3}",
        "replay": f"{dive * VERSIONS + version:032x}",
        "log_sha256": hexes["log"],
        "settings_sha256": hexes["settings"],
        "code_sha256": "",
        "revision": f"v{version:02d}",
        "version": f"0.{version // 10}.0",
        "started_at": f"2026-{1 + version // 20:02d}-{1 + version % 20:02d}T00:00:00.{dive:06d}+00:00",
        "role": "secondary",
    }
    rows: dict[str, list[object]] = {name: [value] * count for name, value in same.items()}
    names = [(filter_, quantity) for filter_ in FILTERS for quantity in QUANTITIES]
    names.append((FILTERS[0], "gyro_bias"))
    rows["filter"] = [filter_ for filter_, _ in names]
    rows["quantity"] = [quantity for _, quantity in names]
    rows["ratio"] = ratios.tolist()
    rows["baseline"] = rng.uniform(0.5, 2.0, count).tolist()
    rows["value"] = rng.uniform(0.5, 2.0, count).tolist()
    for name in ("moves", "acts", "reference_noise", "from_s"):
        rows[name] = [None] * count
    for name in ("samples", "starts"):
        rows[name] = [1] * count
    return rows


def tables() -> list[pa.Table]:
    """Return the rows of all replays, a table for each version."""
    types = {"text": pa.string(), "count": pa.int64(), "number": pa.float64()}
    schema = pa.schema([(column, types[kind]) for column, kind in LAKE.kinds.items()])
    rng = np.random.default_rng(1)
    found = []
    for version in range(VERSIONS):
        parts = [pa.table(evidence(dive, version, rng), schema=schema) for dive in range(DIVES)]
        found.append(pa.concat_tables(parts))
    return found


def queries() -> dict[str, str]:
    """Return the queries of the page, by their titles."""
    found = {}
    for section in re.split(r"^(?=## )", PAGE.read_text("utf-8"), flags=re.MULTILINE):
        query = QUERY.search(section)
        title = TITLES.search(section)
        if query and title:
            found[title[1]] = query[1]
    return found


def took(query: str) -> Took:
    """Return the shortest of some times."""
    *statements, last = ast.parse(query).body
    assert isinstance(last, ast.Expr)
    body = compile(ast.Module(statements, []), str(PAGE), "exec")
    value = compile(ast.Expression(last.value), str(PAGE), "eval")
    times = []
    for _ in range(ROUNDS):
        names: dict[str, object] = {}
        before_s = time.process_time()
        start_s = time.perf_counter()
        exec(body, names)
        eval(value, names)
        times.append(Took(time.perf_counter() - start_s, time.process_time() - before_s))
    return min(times)


def main() -> None:
    """Measure, print and write the page."""
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        lake = Path("lake")
        require_lake(lake, ())
        made = tables()
        rows_of_one = made[0].num_rows // DIVES
        for number in range(FILES_MEASURED):
            single = made[number // DIVES].slice(number % DIVES * rows_of_one, rows_of_one)
            file = lake / ROWS / f"{number:032x}.parquet"
            pq.write_table(
                single, file, use_dictionary=False, compression="none", store_schema=False
            )
        before = {title: took(query) for title, query in queries().items()}
        for file in (lake / ROWS).iterdir():
            file.unlink()
        for number, version in enumerate(made):
            pq.write_table(version, lake / ROWS / f"{number:032x}.parquet", store_schema=False)
        start_s = time.process_time()
        compacted = compact_lake(lake)
        compacting_s = time.process_time() - start_s
        size_mb = sum(file.stat().st_size for file in (lake / ROWS).iterdir()) / 1e6
        after = {title: took(query) for title, query in queries().items()}
        os.chdir("/")
    lines = []
    for title, single_took in before.items():
        each_ms = 1e3 * single_took.processor_s / FILES_MEASURED
        joined = after[title]
        lines.append(
            f"| {title} | {each_ms:.2f} ms | {joined.wall_s:.2f} s | {joined.processor_s:.2f} s |"
        )
    about = (
        f"{compacted.rows} rows of {compacted.replays} replays; joined they have {size_mb:.0f} MB, and joining "
        f"{VERSIONS} files of {made[0].num_rows} rows takes {compacting_s:.1f} s of processor time. *single*: for each "
        f"file of a replay, of {FILES_MEASURED}, in processor time. Allowed are {ALLOWED_S:g} s of it for a query. "
        f"{machine()}."
    )
    columns = ("query", "single", "joined: wall clock", "joined: processor time")
    part = "\n".join(["# Lake: a million rows", "", about, "", *table(columns, lines)])
    write_part(part)
    sys.stdout.write(f"{part}\n")
    raise SystemExit(int(max(joined.processor_s for joined in after.values()) > ALLOWED_S))


if __name__ == "__main__":
    main()
