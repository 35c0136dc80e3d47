"""How a DVL errs: every beam has its own noise, bias and scale."""

from dataclasses import dataclass, replace

import numpy as np

from insdvl_replay.core.columns import DvlColumns, Floats
from insdvl_replay.geometry.beams import beam_vectors
from insdvl_replay.geometry.rotation import turned
from insdvl_replay.sim.imu_errors import quantise


@dataclass(frozen=True)
class DvlErrors:
    """Size of the errors of one beam: ``y = (b . v_d)(1 + scale) + bias + noise``.

    The defaults are those of a 600 kHz bottom-track DVL: 4.2 mm/s in a beam are 6 mm/s in each horizontal axis of four
    beams at 30 deg.

    Attributes
    ----------
    beam_sd_mps : float
        White noise of one reading.
    beam_bias_sd_mps : float
        Standard deviation of a beam's constant offset, drawn once a dive.
    beam_scale_sd : float
        Standard deviation of a beam's scale error, drawn once a dive.
    beam_quantum_mps : float
        Step to which readings are rounded; 0 for none.
    velocity_sd_mps : float
        White noise that the beams of a ping share: each axis of the velocity has as much of it.
    """

    beam_sd_mps: float = 0.0042
    beam_bias_sd_mps: float = 0.001
    beam_scale_sd: float = 0.002
    beam_quantum_mps: float = 1e-4
    velocity_sd_mps: float = 0.0


@dataclass(frozen=True)
class LostBeam:
    """A span in which one beam finds no bottom.

    Attributes
    ----------
    beam : int
        Row of `beam_vectors_d`, from 0.
    start_s, end_s : float
        Seconds from the start of the dive; the end is not part of the span.
    """

    beam: int
    start_s: float
    end_s: float


def beam_vectors_d() -> Floats:
    """Give the unit vectors of a Janus of four beams, from the instrument towards the seabed.

    They are rounded to twelve digits, so that no machine's last bit of a sine shows in a log.

    Returns
    -------
    ndarray, shape (4, 3)
    """
    return np.round(beam_vectors(), 12)


def add_dvl_errors(exact: DvlColumns, errors: DvlErrors, rng: np.random.Generator) -> DvlColumns:
    """Spoil perfect beams; lost ones stay lost.

    Parameters
    ----------
    exact : DvlColumns
        With beams.
    errors : DvlErrors
    rng : numpy.random.Generator

    Returns
    -------
    DvlColumns

    Raises
    ------
    ValueError
        The columns hold no beams.
    """
    if exact.beam_velocity_mps is None or exact.beam_vectors_d is None:
        raise ValueError("the errors of a DVL are drawn for its beams, and these columns hold none")
    pings, beams = exact.beam_velocity_mps.shape
    scale = errors.beam_scale_sd * rng.standard_normal(beams)
    bias = errors.beam_bias_sd_mps * rng.standard_normal(beams)
    noise = errors.beam_sd_mps * rng.standard_normal((pings, beams))
    noise += turned(exact.beam_vectors_d, errors.velocity_sd_mps * rng.standard_normal((pings, 3)))
    reading = exact.beam_velocity_mps * (1.0 + scale) + bias + noise
    return replace(exact, beam_velocity_mps=quantise(reading, errors.beam_quantum_mps))
