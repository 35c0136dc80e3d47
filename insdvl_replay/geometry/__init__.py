"""Mathematics that several rooms share: the Earth, rotations, frames and the tangent plane, the beams of a DVL."""
