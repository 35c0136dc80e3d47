"""The columns of a trajectory, by groups that are compared together."""

from typing import Final

from insdvl_replay.core.states import BA, BG, DV, PHI, STATES

GROUPS: Final = {
    "position": ("position_n_m", "position_e_m", "position_d_m"),
    "velocity": ("velocity_n_mps", "velocity_e_mps", "velocity_d_mps"),
    "attitude": ("roll_deg", "pitch_deg", "heading_deg"),
    "accelerometer_bias": ("ba_x_mg", "ba_y_mg", "ba_z_mg"),
    "gyro_bias": ("bg_x_degph", "bg_y_degph", "bg_z_degph"),
    "velocity_sd": tuple(f"{state.id}_sd" for state in STATES[DV]),
    "misalignment_sd": tuple(f"{state.id}_sd" for state in STATES[PHI]),
    "accelerometer_bias_sd": tuple(f"{state.id}_sd" for state in STATES[BA]),
    "gyro_bias_sd": tuple(f"{state.id}_sd" for state in STATES[BG]),
    "nis": ("nis_velocity", "nis_acceleration"),
    "error": ("position_error_m", "depth_error_m", "velocity_error_mps", "level_error_deg", "heading_error_deg"),
}
"""Quantities that are compared together: a difference is small beside the largest of its group."""
COLUMNS: Final = tuple(column for group in GROUPS.values() for column in group)
ANGLES: Final = ("roll_deg", "pitch_deg", "heading_deg", "heading_error_deg")
"""Columns that go round at 360 deg."""
