"""Sentences $PNORBT of Nortek's DVLs, with the velocity of bottom track.

Sources: the layouts of Nortek's ASCII formats DF356 to DF359 as pynmea2 has them,
https://github.com/Knio/pynmea2/blob/master/pynmea2/types/proprietary/nor.py, and the status word of format DF21, whose
low bits are the validity of the beams, and bits 12 to 14 that of x, y and z.

The other sentences that pynmea2 has are not read. $PNORBT0 and 1 have the velocity along one beam each, and nothing
tells where the beams point and which sign is towards the bottom. $PNORBT3 and 4 have a speed and its direction, and
neither a time nor a vertical velocity.
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

# Cells behind the name: s since 1970, ms, m/s in the axes of the instrument, m/s, m along each beam; -32.768 is no
# velocity.
_SHORT: Final = ("time", "dt1", "dt2", "vx", "vy", "vz", "fom", "d1", "d2", "d3", "d4")
_LONG: Final = (*_SHORT, "battery", "sound_speed", "pressure", "temperature", "status")
# Sentences of an even number have the name of each cell in front of it, as in VX=0.1. The longer ones are the better.
_LAYOUTS: Final = {"PNORBT9": _LONG, "PNORBT8": _LONG, "PNORBT7": _SHORT, "PNORBT6": _SHORT}
_TICKS_PER_S: Final = 10_000  # times have four digits
_NS_PER_TICK: Final = 100_000


class NortekSentences(SentenceFile):
    """A file of sentences of a DVL."""

    nothing_hint = "let the DVL send $PNORBT7 or $PNORBT9, which have a time and three velocities"

    def decode(self, sentence: Sentence) -> Decoded | None:
        """Return the numbers of a sentence with a velocity along three axes."""
        layout = _LAYOUTS.get(sentence.name)
        if layout is None:
            self.pass_over(sentence.name[:10])
            return None
        cells = [cell.rpartition(b"=")[2] for cell in sentence.cells]
        if layout is _SHORT:
            return Decoded(sentence.name, numbers(cells, len(layout)))
        status = float(int(cells[len(layout) - 1], 16))
        return Decoded(sentence.name, [*numbers(cells, len(layout) - 1), status])

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the velocities of the best kind of sentence that there is."""
        rows = self.rows()
        kinds = [kind for kind in _LAYOUTS if kind in rows]
        for kind in kinds[1:]:
            self.pass_over(kind, len(rows[kind]))
        for kind in kinds[:1]:
            found = rows[kind]
            known = self.with_times(found[:, 0], found[:, 1])
            found = found[known]
            columns: dict[str, Array] = {}
            for place, name in enumerate(_LAYOUTS[kind], 1):
                columns[name] = found[:, place]
            columns["velocity"] = found[:, 4:7]
            columns["distance"] = found[:, 8:12]
            ticks = np.rint(columns.pop("time") * _TICKS_PER_S)
            yield InstrumentTable(
                topic="dvl/bottom_track",
                type_name="nortek.bottom_track",
                time_ns=ticks.astype(np.int64) * _NS_PER_TICK,
                columns=columns,
            )
