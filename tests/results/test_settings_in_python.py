"""Settings as Python has them: NumPy's numbers, paths, mappings."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl_replay import load_config
from insdvl_replay.core.errors import ConfigError


@pytest.mark.parametrize("numbers", [
    np.array([1.0, 0.5, 3.0]), list(np.array([1.0, 0.5, 3.0])), (np.float64(1.0), np.float32(0.5), np.int64(3)),
])  # fmt: skip
def test_numbers_may_be_numpys(numbers: Any) -> None:
    config = load_config(
        settings={"dvl.lever_arm_m": numbers, "reference.independent": np.bool_(False)}
    )
    assert config.dvl.lever_arm_m == (1.0, 0.5, 3.0)
    assert config.reference.independent is False


def test_a_file_may_be_a_path(tmp_path: Path) -> None:
    (tmp_path / "onboard.tum").write_text("0 0 0 0 0 0 0 1\n")
    config = load_config(settings={"filters.onboard.solution.file": tmp_path / "onboard.tum"})
    assert config.solutions["onboard"].file == str(tmp_path / "onboard.tum")


def test_a_mapping_sets_the_keys_in_it() -> None:
    mine = {
        "aiding": ("velocity", "acceleration"),
        "acceleration": {"model": "windowed", "window": np.int64(3)},
    }
    config = load_config(settings={"filters.mine": mine, "dvl": {"scale": 1.01}})
    same = [
        'filters.mine.aiding=["velocity","acceleration"]',
        'filters.mine.acceleration={model="windowed",window=3}',
    ]
    assert config == load_config(settings=[*same, "dvl.scale=1.01"])


@pytest.mark.parametrize("value", [None, [1.0, None, 2.0], np.array([1.0, None, 2.0])])
def test_none_is_reported(value: Any) -> None:
    with pytest.raises(ConfigError, match=r"^dvl.lever_arm_m: None"):
        load_config(settings={"dvl": {"lever_arm_m": value}})
