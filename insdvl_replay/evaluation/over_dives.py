"""The names of this chapter."""

from insdvl_replay.evaluation.pooled_evidence import (
    PooledCandidate,
    pooled_candidate,
    pooled_evidence,
    pooled_judgement,
    pooled_sentence,
)

__all__ = ["PooledCandidate", "pooled_candidate", "pooled_evidence", "pooled_judgement", "pooled_sentence"]
