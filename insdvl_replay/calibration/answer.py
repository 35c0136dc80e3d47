"""The answer of a calibration: whether the estimates are better than the settings, by the dives that were held out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.calibration import Calibration
from insdvl_replay.calibration.innovations import LABELS
from insdvl_replay.calibration.rows import HeldOutRow
from insdvl_replay.core.errors import counted
from insdvl_replay.core.result import Callout
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.show.document import numbers_apart

NO_CHANGE: Final = 0.01  # so small a change of the drift on held-out dives is none
MORE_DRIFT: Final = "it increases the drift on held-out dives"
WORSE_NIS: Final = "it makes NIS/dof worse on held-out dives"
_SHOWN: Final = 3  # parameters in the sentence


@dataclass(frozen=True)
class Answer:
    """What to do with the estimates of the geometry, and of the noise."""

    lines: tuple[Callout, ...]
    keeps_geometry: bool  # the estimates are worse than the settings
    keeps_noise: bool

    def applied(self, found: Calibration) -> Calibration:
        """Return the calibration with what is better alone: the rest is held, with the reason."""
        if self.keeps_geometry:
            rows = tuple(
                msgspec.structs.replace(row, status=Estimated.HELD, why=MORE_DRIFT)
                if row.status == Estimated.ESTIMATED
                else row
                for row in found.rows
            )
            found = replace(found, rows=rows, after=found.before, change=np.zeros_like(found.change), reference=None)
        if self.keeps_noise:
            noise = tuple(
                msgspec.structs.replace(row, status=Estimated.HELD, why=WORSE_NIS, after=row.before)
                if row.is_proposed
                else row
                for row in found.noise_rows
            )
            found = replace(found, noise_rows=noise)
        return found


def answer_of(found: Calibration) -> Answer:
    """Judge the geometry by the drift on held-out dives, and the noise by their NIS."""
    names = [LABELS[row.parameter] for row in found.estimated]
    dives, before_m, after_m = _means(found.held_out, "drift_before_m", "drift_after_m")
    keeps_geometry = bool(names) and after_m > (1.0 + NO_CHANGE) * before_m
    if not names:
        geometry = "Keep your settings: these dives have no manoeuvre that determines others."
    elif dives:
        what = "Keep your settings" if keeps_geometry else "Use the new settings"
        geometry = f"{what}: on {dives} drift in 60 s without DVL {_change(before_m, after_m)} m."
    else:
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        untested = "The held-out dives have no window to test them" if found.held_out else "Test them: --hold-out 0.3"
        geometry = f"New settings: {', '.join(names[:_SHOWN])}{more}. {untested}."
    is_asked = any(row.status != Estimated.NOT_ASKED for row in found.all_rows)
    lines = [Callout(geometry, "good" if names and not keeps_geometry else "bad")] if is_asked else []

    keeps_noise = False
    if found.proposes_noise:
        dives, before, after = _means(found.held_out, "nis_per_dof_before", "nis_per_dof_noise")
        changes = (f"{row.parameter} {_change(row.before, row.after)}" for row in found.noise_rows if row.is_proposed)
        noise = f"Change the noise: {', '.join(changes)}."
        if dives:
            keeps_noise = abs(math.log(after)) > abs(math.log(before))
            what = "Keep your noise" if keeps_noise else "Change the noise"
            noise = f"{what}: NIS/dof on {dives} {_change(before, after)}, expected 1."
        lines.append(Callout(noise, "bad" if keeps_noise else "good"))
    return Answer(tuple(lines), keeps_geometry, keeps_noise)


def _means(rows: Sequence[HeldOutRow], before: str, after: str) -> tuple[str, float, float]:
    """Count the dives that have both values, empty for none, and return geometric means: each dive counts the same."""
    pairs = [(finite(getattr(row, before)), finite(getattr(row, after))) for row in rows]
    pairs = [pair for pair in pairs if pair[0] > 0.0 and pair[1] > 0.0]
    if not pairs:
        return "", math.nan, math.nan
    old, new = np.exp(np.log(pairs).mean(axis=0)).tolist()
    return counted(len(pairs), "held-out dive"), old, new


def _change(before: float, after: float) -> str:
    return " -> ".join(numbers_apart(before, after))
