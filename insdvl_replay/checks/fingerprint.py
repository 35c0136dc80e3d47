"""A fingerprint of an IMU's readings, by which copies and parts of a dive are known from their results alone.

Readings at whole tens of seconds tell copies with the same times. A copy whose stamps were moved has none of them, so
that some samples are marked by their readings alone: those whose hash is divisible by a power of two. A part of a
dive has the same marks as the whole.
"""

import hashlib
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, ImuColumns, Integers
from insdvl_replay.core.dive_record import ImuFingerprint

STEP_S: Final = 10
MOST_DIGESTS: Final = 300
MOST_MARKS: Final = 128
# Times of another encoding are rounded; no usual grid of samples begins here.
EARLY_NS: Final = 700_000
# Far above what single precision and six decimals round, below the noise of an IMU.
FORCE_STEP_MPS2: Final = 1e-4
RATE_STEP_RADPS: Final = 1e-5
DIGEST_BYTES: Final = 4
_AT_ONCE: Final = 1_000_000  # samples, to save memory
_NS_PER_MS: Final = 1_000_000
# Odd numbers with about as many ones as zeros, and shifts: they mix the bits of a reading.
_MIXED_BY: Final = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9)
_SHIFTS: Final = (29, 32)


def imu_fingerprint(imu: ImuColumns) -> ImuFingerprint:
    """Digest the first sample at or after each whole ten seconds of the log's clock, rounded; of long dives fewer.

    The sizes of specific force and angular rate are digested, which no choice of axes changes. Others are marked.
    """
    first_ns = int(imu.time_ns[0])
    last_ns = int(imu.time_ns[-1])
    step_s = STEP_S
    while (last_ns - first_ns) // (step_s * NS_PER_S) >= MOST_DIGESTS:
        step_s *= 2
    step_ns = step_s * NS_PER_S
    whole = np.arange(-(-first_ns // step_ns), last_ns // step_ns + 1)
    rows = np.searchsorted(imu.time_ns, whole * step_ns - EARLY_NS)
    inside = rows < len(imu.time_ns)
    whole = whole[inside]
    one_in = 1
    while len(imu.time_ns) > one_in * MOST_MARKS:
        one_in *= 2
    marked = _marked(imu, one_in)
    since_ns = imu.time_ns[marked] - first_ns
    return ImuFingerprint(
        first_ns,
        last_ns,
        tuple((whole * step_s).tolist()),
        tuple(_digests(_rounded(imu, rows[inside]))),
        one_in,
        tuple((since_ns // _NS_PER_MS).tolist()),
        tuple(_digests(_rounded(imu, marked))),
    )


def _rounded(imu: ImuColumns, rows: Integers | slice) -> Integers:
    """Return the sizes of specific force and angular rate in steps, shape (k, 2)."""
    forces = np.linalg.norm(imu.specific_force_b[rows], axis=1) / FORCE_STEP_MPS2
    rates = np.linalg.norm(imu.angular_rate_b[rows], axis=1) / RATE_STEP_RADPS
    return np.asarray(np.rint(np.column_stack([forces, rates])).astype("<i8"))


def _digests(readings: Integers) -> Sequence[str]:
    """Return a digest of each row."""
    digests = []
    for reading in readings:
        digest = hashlib.blake2b(reading.tobytes(), digest_size=DIGEST_BYTES)
        digests.append(digest.hexdigest())
    return digests


def _marked(imu: ImuColumns, one_in: int) -> Integers:
    """Return the rows of about one in so many readings, by their hashes; of equal readings none is marked."""
    rows = []
    hashes = []
    for first in range(0, len(imu.time_ns), _AT_ONCE):
        hashed = _hashed(_rounded(imu, slice(first, first + _AT_ONCE)))
        chosen = np.flatnonzero(hashed % np.uint64(one_in) == 0)
        rows.append(first + chosen)
        hashes.append(hashed[chosen])
    _, places, counts = np.unique(np.concatenate(hashes), return_index=True, return_counts=True)
    return np.sort(np.concatenate(rows)[places[counts == 1]])


def _hashed(readings: Integers) -> NDArray[np.uint64]:
    """Return a number for each row that looks drawn at random, and is the same for equal rows."""
    force, rate = readings.astype(np.uint64).T
    first, second = map(np.uint64, _MIXED_BY)
    mixed = force * first + rate * second
    for shift in map(np.uint64, _SHIFTS):
        mixed = (mixed ^ (mixed >> shift)) * second
    return np.asarray(mixed ^ (mixed >> np.uint64(_SHIFTS[-1])))
