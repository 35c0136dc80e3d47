"""How the four beams of a ping agree: their noise, measured without a filter.

Of four readings of a velocity of three components one combination holds nothing of it. Of a Janus it is half of
``y1 - y2 + y3 - y4``, the error velocity of the instrument's maker; its noise is that of one beam.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.history import Innovations
from insdvl_replay.core.quantities import PARITY
from insdvl_replay.nav.dvl import DvlBeams

BEAMS: Final = 4
"""With fewer there is nothing to agree; of more than four, one number would not say how."""


def parity_innovations(beams: DvlBeams, sd_mps: float) -> tuple[Innovations, ...]:
    """Return the parity of each ping that has four beams, as an innovation that no filter predicted; else nothing.

    Parameters
    ----------
    beams : DvlBeams
    sd_mps : float
        Noise of one beam, as a filter is told it.
    """
    if len(beams.directions_b) != BEAMS:
        return ()
    blind = np.linalg.svd(beams.directions_b.T)[2][-1]
    whole = np.isfinite(beams.beam_velocity_mps).all(axis=1)
    parity_mps = np.sum(beams.beam_velocity_mps[whole] * blind, axis=1) * np.sign(blind[0])
    count, time_ns = int(whole.sum()), beams.time_ns[whole]
    sd, no = np.full((count, 1), sd_mps), np.zeros(count, np.bool_)
    return (
        Innovations(
            measurement=PARITY,
            unit="m/s",
            axes=(),
            time_ns=time_ns,
            valid_ns=time_ns,
            measured=parity_mps[:, None],
            innovation=parity_mps[:, None],
            sd=sd,
            nis=(parity_mps / sd_mps) ** 2,
            used=~no,
            log_det=np.full(count, 2.0 * np.log(sd_mps)),
            gate=np.inf,
            reopen_after=0,
            reopened=no,
        ),
    )
