"""The baseline against python-ins: another's mechanisation, error model and Kalman filter on the same readings."""

import numpy as np
import pytest
from python_ins import Case, our_belief, their_belief
from scipy.spatial.transform import Rotation

from insdvl_replay.core.states import PHI
from insdvl_replay.preparation.replay import replay_dive

FIRST_TURN_S = 123.0


@pytest.mark.filterwarnings(
    "ignore:The copy keyword is deprecated"
)  # python-ins calls pandas the old way
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(Case("straight"), id="straight", marks=pytest.mark.nightly),
        pytest.param(Case(), id="turns", marks=pytest.mark.nightly),
        pytest.param(Case(beams=(0, 1, 3)), id="three beams", marks=pytest.mark.nightly),
        pytest.param(
            Case(lever_arm_m=(-1.8, 0.3, 0.5)), id="lever arm", marks=pytest.mark.nightly
        ),
        pytest.param(
            Case(mounting_rpy_deg=(3.0, -2.0, 45.0)),
            id="mounting rotation",
            marks=pytest.mark.nightly,
        ),
        # As cheap as it can be: a lever arm and a rotation, in the first of the two turns.
        pytest.param(
            Case(
                lever_arm_m=(-1.8, 0.3, 0.5),
                mounting_rpy_deg=(3.0, -2.0, 45.0),
                end_s=FIRST_TURN_S,
            ),
            id="lever arm and mounting rotation",
        ),
    ],
)
def test_baseline_predicts_what_python_ins_predicts(case: Case) -> None:
    dive = case.dive()
    (history,) = replay_dive(dive, case.config()).histories
    ours, theirs = (
        our_belief(history, int(dive.dvl.time_ns[-1])),
        their_belief(dive, case.velocities(dive)),
    )
    turned = Rotation.from_matrix(ours.mat_nb @ theirs.mat_nb.T).as_rotvec()
    np.testing.assert_allclose(ours.bias_sd, theirs.bias_sd, rtol=0.005)
    np.testing.assert_allclose(
        ours.biases / ours.bias_sd, theirs.biases / ours.bias_sd, rtol=0.0, atol=0.06
    )
    np.testing.assert_allclose(ours.velocity_n, theirs.velocity_n, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(turned / history.sd[-1, PHI], 0.0, atol=0.1)
