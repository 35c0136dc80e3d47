"""A vehicle whose axes go round on cones, as in a swell from everywhere, while it holds a straight course."""

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.sim.trajectories import SCENARIOS, sine_and_cosine


class Coning:
    """A straight course, with roll and pitch a quarter of a period apart."""

    about = "coning"
    duration_s = 600.0

    def __init__(self, cone_deg: float, period_s: float) -> None:
        self.course = SCENARIOS["straight"]
        self.velocity_b, self.velocity_rate_b = self.course.velocity_b, self.course.velocity_rate_b
        self.cone, self.frequency = cone_deg * DEG, 2.0 * np.pi / period_s

    def rpy(self, time_s: Floats) -> Floats:
        """Roll, pitch and heading, rad."""
        sine, cosine = sine_and_cosine(self.frequency * time_s)
        swing = self.cone * np.column_stack([sine, cosine, np.zeros_like(sine)])
        return np.asarray(self.course.rpy(time_s) + swing)

    def rpy_rate(self, time_s: Floats) -> Floats:
        """Their rates, rad/s."""
        sine, cosine = sine_and_cosine(self.frequency * time_s)
        swing = self.cone * self.frequency * np.column_stack([cosine, -sine, np.zeros_like(sine)])
        return np.asarray(self.course.rpy_rate(time_s) + swing)
