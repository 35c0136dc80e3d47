"""Sentences $DVPDL and $DVPDX of Cerulean's Tracker 650 and DVL-75: how far the vehicle came since the last one.

Source: Cerulean Sonar, "$DVPDL and $DVPDX: DVL Position and Angle Deltas Messages", in the documentation of the Tracker
650, https://docs.ceruleansonar.com/c/tracker-650/. Positions are in the axes of ArduSub, forward-starboard-down.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Array
from insdvl_replay.logs.formats.instrument_file import InstrumentTable
from insdvl_replay.logs.formats.sentences import (
    Decoded,
    Sentence,
    SentenceFile,
    numbers,
)

# Cells behind the name: us since the start of the instrument, us, rad, m, and a confidence of 0 to 100. A $DVPDX has
# some more behind them.
_LAYOUT: Final = ("time_us", "time_delta_us", "roll", "pitch", "yaw", "x", "y", "z", "confidence")
_NAMES: Final = ("DVPDL", "DVPDX")
_LONGEST_US: Final = (
    10_000_000.0  # between two sentences; over a longer pause there is no velocity
)


class CeruleanSentences(SentenceFile):
    """A file of sentences of a DVL."""

    def decode(self, sentence: Sentence) -> Decoded | None:
        """Return the numbers of a sentence with a displacement."""
        if sentence.name not in _NAMES:
            self.pass_over(sentence.name[:10])
            return None
        return Decoded(sentence.name, numbers(sentence.cells, len(_LAYOUT)))

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the displacements; of a file with both sentences, the shorter ones."""
        rows = self.rows()
        kinds = [name for name in _NAMES if name in rows]
        for kind in kinds[1:]:
            self.pass_over(kind, len(rows[kind]))
        for kind in kinds[:1]:
            found = rows[kind]
            known = self.with_times(found[:, 0], found[:, 1] * 1e-6)
            found = found[known]
            single = {name: found[:, place] for place, name in enumerate(_LAYOUT, 1)}
            interval_us = single["time_delta_us"]
            is_interval = (interval_us > 0.0) & (interval_us < _LONGEST_US)
            columns: dict[str, Array] = {
                "position_delta": found[:, 6:9],
                "angle_delta": found[:, 3:6],
                "time_delta_us": np.where(is_interval, interval_us, np.nan),
                "confidence": single["confidence"],
            }
            yield InstrumentTable(
                topic="dvl/position_delta",
                type_name="cerulean.position_delta",
                time_ns=single["time_us"].astype(np.int64) * 1000,
                columns=columns,
            )
