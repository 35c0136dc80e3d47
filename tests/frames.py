"""Tables of a replay as pandas has them, to be asked questions."""

from collections.abc import Sequence

import msgspec
import pandas as pd
from msgspec import Struct

from insdvl_replay.core.tables import Tables, each_table


def frame(rows: Sequence[Struct]) -> pd.DataFrame:
    """Give the rows of a table."""
    return pd.DataFrame([msgspec.to_builtins(row) for row in rows])


def frames(tables: Tables) -> dict[str, pd.DataFrame]:
    """Give all tables, by name."""
    return {layout.name: frame(rows) for layout, rows in each_table(tables)}
