"""What numbers of a replay say on its settings, and which command follows it up: `calibrate`, or `run --control`."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import AXES, axis_of
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import Tables
from insdvl_replay.evaluation.consistency import repeats

APART: Final = 5.0
"""Times by which the NIS of one axis is above another's: what a DVL is built in otherwise does not reach all alike."""
TOO_LARGE: Final = 1.5
"""NIS over degrees of freedom from which an axis is compared with down, too: beams 30 deg off the vertical measure with
six times less variance down, of which a filter that takes all axes for alike knows nothing."""
TELLING_PCT, TELLING_DEG = 0.5, 0.5
CERTAIN_SDS: Final = 5.0
"""Standard errors by which a track has to be off; those of a turn hold what the filter knows of its heading, too."""
LEAST, MOST = 0.2, 5.0
"""Mean NIS over degrees of freedom outside which noise is set far off."""
NOISE_FAR_OFF: Final = "noise_far_off"
_CALIBRATE: Final = (
    "`insdvl-replay calibrate` with the same settings estimates arm, mounting, delay and scale of the DVL"
)
_CONTROL: Final = "`insdvl-replay run --control` adds a baseline whose noise is fitted to the dive"


def settings_hints(tables: Tables, history: History) -> tuple[Note, ...]:
    """Point at what the baseline's innovations and track say on how the DVL is built in, and on the noise.

    Parameters
    ----------
    history : History
        Of the baseline.

    Returns
    -------
    tuple of Note
        For information; empty where nothing is far off, or there is nothing to tell it by.
    """
    heading_sd_deg = float(np.max(history.sd[[0, -1], PHI.stop - 1])) / DEG
    name = history.filter
    return (*_axes_apart(tables, name), *_track_off(tables, name, heading_sd_deg), *_noise_far_off(tables, name))


def constants_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Note what filters take the constants of the sensors to be at the end: scale and yaw of the DVL, the gauge's zero.

    Of adaptive noise, too, by how much it is larger than said.

    Returns
    -------
    tuple of Note
        For information, one for each filter that estimates any.
    """
    return tuple(
        Note("constants_estimated", f"{history.filter} estimates: {'; '.join(found)}", len(found))
        for history in histories
        if (found := [*_constants(history), *_noise_found(history)])
    )


def _constants(history: History) -> Iterator[str]:
    count = history.constants.shape[1]
    for column, state in enumerate(history.states[len(history.states) - count :]):
        value, start = (history.constants[row, column] / state.factor for row in (-1, 0))
        sd, start_sd = (history.sd[row, state.index] / state.factor for row in (-1, 0))
        yield (
            f"{state.label} {value:+.3g} {state.unit} (sd {sd:.2g} {state.unit}; "
            f"at the start {start:+.3g}, sd {start_sd:.2g})"
        )


def _noise_found(history: History) -> Iterator[str]:
    for innovations in history.innovations:
        if innovations.noise_factor != 1.0:
            yield f"noise of {innovations.measurement} {math.sqrt(innovations.noise_factor):.3g} times what it is told"


def _nis_per_dof(tables: Tables, baseline: str) -> dict[str, float]:
    return {row.measurement: finite(row.mean_nis) / row.dof for row in tables.consistency if row.filter == baseline}


def _axes_apart(tables: Tables, baseline: str) -> Iterator[Note]:
    known = _nis_per_dof(tables, baseline)
    sizes = {axis: known[name] for axis in AXES if (name := axis_of("velocity", axis)) in known}
    high = max(sizes, key=sizes.__getitem__, default="")
    compared = {axis: size for axis, size in sizes.items() if axis != AXES[-1] or sizes[high] > TOO_LARGE}
    low = min(compared, key=compared.__getitem__, default="")
    if low and sizes[low] > 0.0 and sizes[high] > APART * sizes[low]:
        listed = ", ".join(f"{axis} {size:.2g}" for axis, size in sizes.items())
        text = (
            f"the innovations of {baseline} are not alike along the axes: mean NIS / dof {listed}, along {high} "
            f"{sizes[high] / sizes[low]:.3g} times that along {low}; arm, mounting or delay of the DVL may be off"
        )
        yield Note("innovations_apart", text, 1, hint=_CALIBRATE)


def _track_off(tables: Tables, baseline: str, heading_sd_deg: float) -> Iterator[Note]:
    telling = {"scale": (TELLING_PCT, 0.0), "turn": (TELLING_DEG, heading_sd_deg)}
    off = []
    for row in tables.track_fit:
        size, (least, known_sd) = abs(finite(row.fitted)), telling[row.quantity]
        sd = math.hypot(finite(row.fitted_sd), known_sd)
        if row.filter == baseline and size > least and size > CERTAIN_SDS * sd:
            off.append(f"a {row.quantity} of {finite(row.fitted):+.2f} {row.unit} (sd {sd:.2g} {row.unit})")
    if off:
        text = (
            f"{' and '.join(off)} would lay the track of {baseline} on the reference's: dvl.scale, "
            "dvl.mounting_rpy_deg or initial.heading_deg may be off"
        )
        yield Note("track_off", text, len(off), hint=_CALIBRATE)


def is_noise_far_off(tables: Tables, baseline: str) -> bool:
    """Return whether the size of the innovations tells that the noise is set far off.

    Small ones that repeat themselves do not: they are an error that stays, which less noise would make worse.
    """
    row = next((row for row in tables.consistency if (row.filter, row.measurement) == (baseline, "velocity")), None)
    if row is None or row.mean_nis is None:
        return False
    size = row.mean_nis / row.dof
    return size > MOST or (size < LEAST and not repeats(finite(row.autocorrelation), finite(row.autocorrelation_limit)))


def _noise_far_off(tables: Tables, baseline: str) -> Iterator[Note]:
    if is_noise_far_off(tables, baseline):
        size = _nis_per_dof(tables, baseline)["velocity"]
        text = (
            f"the innovations of {baseline} are far {'smaller' if size < LEAST else 'larger'} than it says: mean NIS / "
            f"dof of velocity is {size:.2g}, 1 is expected"
        )
        yield Note(NOISE_FAR_OFF, text, 1, hint=_CONTROL)
