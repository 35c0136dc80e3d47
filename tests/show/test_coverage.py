"""The strips of a page: how much of the dive each sensor covers, and the times below them."""

import re
from types import SimpleNamespace

from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.show.plots.coverage import coverage_strips
from insdvl_replay.sim.dive import simulate_dive


def test_a_time_at_the_right_end_is_in_line_with_the_others_and_above_the_label() -> None:
    dive = simulate_dive("straight", seed=1, duration_s=60.0, imu_rate_hz=20.0)
    start_ns = int(dive.imu.time_ns[0])
    replay = SimpleNamespace(dive=dive, start_ns=start_ns, end_ns=start_ns + 60 * NS_PER_S)
    found = re.findall(
        r'x="([\d.]+)%" y="(\d+)" text-anchor="(\w+)">([^<]+)<',
        coverage_strips(replay),  # type: ignore[arg-type]
    )
    *times, label = found
    assert times[-1] == ("100.0", "12", "end", "60")
    assert {down for _, down, _, _ in times} == {"12"}
    assert label == ("100.0", "28", "end", "time [s]")
