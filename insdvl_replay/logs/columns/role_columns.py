"""The columns of the roles, made of their tables: for a replay, which the first error ends, as for a dry run of one."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from insdvl_replay.core.clock import Clock
from insdvl_replay.core.columns import DvlColumns, ImuColumns, ReferenceColumns, TruthColumns
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note
from insdvl_replay.logs.columns.clocks import clock_notes
from insdvl_replay.logs.columns.dvl import decode_dvl
from insdvl_replay.logs.columns.imu import decode_imu, decode_truth
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.tables import Table


def _no_pings() -> DvlColumns:
    return DvlColumns(np.empty(0, np.int64), velocity_d=np.empty((0, 3)))


@dataclass
class RoleColumns:
    """The columns of the roles as far as they are read.

    Parameters
    ----------
    place : str
        The file, for messages to the user.
    """

    place: str
    config: Config
    imu: ImuColumns | None = None
    dvl: DvlColumns = field(default_factory=_no_pings)
    reference: ReferenceColumns | None = None
    truth: TruthColumns | None = None

    def decode(self, role: str, tables: list[Table]) -> list[Note]:
        """Make the columns of a role; the raw ones are let go, since those of a long dive are large.

        Parameters
        ----------
        role : {'imu', 'dvl', 'reference', 'truth'}
        tables : list of Table
            At least one; of a reference up to two.
        """
        if role == "reference":
            self.reference, notes = decode_reference(tables, self.config.reference)
        elif role == "imu":
            self.imu, notes = decode_imu(tables.pop(), self.config.imu)
        elif role == "dvl":
            self.dvl, notes = decode_dvl(tables.pop(), self.config.dvl)
        else:
            self.truth, notes = decode_truth(tables.pop())
        return notes

    def clock_notes(self, clocks: Sequence[Clock]) -> tuple[Note, ...]:
        """Compare the clocks of the roles, that of the IMU first, as `clocks.clock_notes`."""
        return clock_notes(self.place, clocks, self.config.clocks.max_disagreement_s)
