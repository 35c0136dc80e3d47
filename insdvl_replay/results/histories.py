"""Histories as tables: all that a filter said, whenever it said it, in shown units."""

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from insdvl_replay.core.dive_columns import seconds
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG, STATES
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.report.csv_tables import table_csv
from insdvl_replay.results.folder import history_file

if TYPE_CHECKING:
    import pandas as pd

    from insdvl_replay.core.history import History

CSV, PARQUET = "csv", "parquet"
_AXES: Final = ("x", "y", "z")


def history_frame(history: "History") -> "pd.DataFrame":
    """Lay out the history of a filter, a row for each time.

    Returns
    -------
    DataFrame
        Columns time_ns, time_s from the start, updated, latitude_deg, longitude_deg, height_m, velocity_n_mps and so
        on, roll_deg, pitch_deg, heading_deg, ba_x_mg and so on, bg_x_degph and so on, and dv_n_sd and so on: the
        standard deviations of all states.
    """
    import pandas as pd

    rpy_deg = rpy_from_mat(history.mat_nb) / DEG
    columns: dict[str, object] = {
        "time_ns": history.time_ns,
        "time_s": seconds(history.time_ns, history.time_ns[0]),
        "updated": history.updated,
        "latitude_deg": history.position[:, 0] / DEG,
        "longitude_deg": history.position[:, 1] / DEG,
        "height_m": history.position[:, 2],
        **{f"velocity_{axis}_mps": history.velocity_n[:, place] for place, axis in enumerate("ned")},
        **{f"{name}_deg": rpy_deg[:, place] for place, name in enumerate(("roll", "pitch", "heading"))},
        **{f"ba_{axis}_mg": history.accel_bias_b[:, place] / MG for place, axis in enumerate(_AXES)},
        **{f"bg_{axis}_degph": history.gyro_bias_b[:, place] / DEG_PER_HOUR for place, axis in enumerate(_AXES)},
        **{f"{state.id}_sd": history.sd[:, state.index] / state.factor for state in STATES},
    }
    return pd.DataFrame({name: np.asarray(column) for name, column in columns.items()})


def write_history(history: "History", folder: Path, format_: str) -> None:
    """Write a history as CSV, with all digits, or as Parquet."""
    path, frame = folder / history_file(history.filter, format_), history_frame(history)
    if format_ == CSV:
        path.write_bytes(table_csv(frame))
        return
    require_parquet()
    frame.to_parquet(path, index=False)


def require_parquet() -> None:
    """Raise a ConfigError where nothing can write Parquet."""
    try:
        import pyarrow  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise ConfigError("--history parquet needs pyarrow", "pip install pyarrow, or --history csv") from error
