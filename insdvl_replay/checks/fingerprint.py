"""A fingerprint of an IMU's readings, by which copies and parts of a dive are known from their results alone."""

import hashlib
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, ImuColumns
from insdvl_replay.core.dive_record import ImuFingerprint

STEP_S: Final = 10
MOST_DIGESTS: Final = 300
# Times of another encoding are rounded; no usual grid of samples begins here.
EARLY_NS: Final = 700_000
# Far above what single precision and six decimals round, below the noise of an IMU.
FORCE_STEP_MPS2: Final = 1e-4
RATE_STEP_RADPS: Final = 1e-5
DIGEST_BYTES: Final = 4


def imu_fingerprint(imu: ImuColumns) -> ImuFingerprint:
    """Digest the first sample at or after each whole ten seconds of the log's clock, rounded; of long dives fewer.

    The sizes of specific force and angular rate are digested, which no choice of axes changes.
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
    rows = rows[inside]
    forces = np.linalg.norm(imu.specific_force_b[rows], axis=1) / FORCE_STEP_MPS2
    rates = np.linalg.norm(imu.angular_rate_b[rows], axis=1) / RATE_STEP_RADPS
    digests = []
    for reading in np.rint(np.column_stack([forces, rates])).astype("<i8"):
        digest = hashlib.blake2b(reading.tobytes(), digest_size=DIGEST_BYTES)
        digests.append(digest.hexdigest())
    return ImuFingerprint(first_ns, last_ns, tuple((whole * step_s).tolist()), tuple(digests))
