"""Mathematics that several rooms share: the Earth, rotations, the beams of a DVL, and positions as ROS has them."""
