"""Settings: layers, strictness, and what a mistake is told."""

import tomllib
from pathlib import Path

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from insdvl_replay.core.config import FREE, Acceleration, Config, Dvl, Filter, Noise
from insdvl_replay.core.config_file import PRESETS, load_config, render_toml
from insdvl_replay.core.errors import ConfigError


def written(folder: Path, text: str) -> Path:
    file = folder / "vehicle.toml"
    file.write_text(text, encoding="utf-8")
    return file


RUN = '[filters.a]\naiding = ["velocity"]\n[filters.b]\n'
"""Settings with a baseline, before the keys of another filter."""


def test_the_papers_setting_is_a_preset_and_the_default_fits_the_noise() -> None:
    config, paper = load_config(), load_config("levy-klein")
    assert config == msgspec.structs.replace(Config(), filters=load_config("fog").filters)
    assert config.noise.fit == tuple(FREE)
    assert paper.filters == Config().filters
    assert (paper.noise, paper.initial.uncertainty) == (Noise(), "settings")
    assert (config.baseline, list(config.filters)) == ("baseline", ["baseline", "aided"])


@pytest.mark.parametrize(
    ("text", "fitted"),
    [
        ("[dvl]\nscale = 1.01\n", ("imu", "dvl", "biases")),
        ("[dvl]\nvelocity_sd_mps = 0.02\n", ("imu", "biases")),
        ("[initial]\ngyro_bias_sd_degph = 10.0\n", ("imu", "dvl")),
        ('[filters.baseline]\naiding = ["velocity"]\n', ("imu", "dvl", "biases")),
        ('[filters.baseline]\naiding = ["velocity"]\nbeam_sd_mps = 0.01\n', ("imu", "biases")),
        ("[noise]\ngyro_white_rad_rts = 3.7e-5\n", ()),
        ("[noise]\nfit = []\n", ()),
        ('[noise]\nfit = ["dvl"]\ngyro_white_rad_rts = 1e-5\n', ("dvl",)),
    ],
)
def test_what_nobody_gives_of_the_noise_is_fitted(
    text: str, fitted: tuple[str, ...], tmp_path: Path
) -> None:
    """Also a value that is that of the default counts as given."""
    file = written(tmp_path, text)
    config = load_config(file=file)
    assert config.noise.fit == fitted
    assert load_config("fog", file).noise.fit == (fitted if "fit" in text else ())
    for changed_only in (False, True):
        again = written(tmp_path, render_toml(config, changed_only=changed_only))
        assert load_config(file=again).noise == config.noise


def test_only_the_papers_setting_starts_as_uncertain_as_the_settings(tmp_path: Path) -> None:
    file = written(tmp_path, "[dvl]\nscale = 1.01\n")
    assert load_config(overrides=["dvl.scale=1.01"]).initial.uncertainty == "source"
    assert load_config("levy-klein", file).initial.uncertainty == "settings"
    assert load_config(None, file).initial.uncertainty == "source"
    assert load_config("fog").initial.uncertainty == "source"


def test_later_layers_win(tmp_path: Path) -> None:
    file = written(tmp_path, "[initial]\naccel_bias_sd_mg = 7.0\n[dvl]\nscale = 1.01\n")
    config = load_config("mems", file, ["dvl.scale=1.02"])
    assert config.noise == load_config("mems").noise != Config().noise
    assert (config.initial.accel_bias_sd_mg, config.dvl.scale) == (7.0, 1.02)


def test_a_file_with_filters_names_all_filters(tmp_path: Path) -> None:
    file = written(tmp_path, '[filters.alone]\naiding = ["velocity"]\n')
    assert load_config("fog", file).filters == {"alone": Filter(aiding=("velocity",))}


def test_later_files_add_filters_and_replace_those_of_the_same_name(tmp_path: Path) -> None:
    first = written(tmp_path, f'{RUN}aiding = ["beams"]\ngate_probability = 0.9\n')
    second = tmp_path / "more.toml"
    second.write_text('[filters.c]\naiding = ["velocity"]\n[filters.b]\naiding = ["depth"]\n')
    said: list[str] = []
    filters = load_config("fog", [first, second], report=said.append).filters
    assert list(filters) == ["a", "b", "c"], "the baseline stays first"
    assert filters["b"] == Filter(aiding=("depth",)), "no key of the replaced filter stays"
    assert said == [f"{second} replaces the filter b of {first}"]
    load_config("fog", [first, first], report=said.append)
    assert len(said) == 1, "the same filter again is no news"


def test_false_leaves_a_filter_out(tmp_path: Path) -> None:
    assert list(load_config(overrides=["filters.aided=false"]).filters) == ["baseline"]
    file = written(tmp_path, "[filters]\nbaseline = false\n")
    assert list(load_config("fog", file).filters) == ["aided"], (
        "a file that defines no filter keeps those of the preset"
    )
    for source in (
        {"file": file, "overrides": ["filters.baseline=false"]},
        {"overrides": ["filters.aidd=false"]},
    ):
        with pytest.raises(
            ConfigError, match=r"^--set filters\.\w+=false: filter '\w+' is not known"
        ):
            load_config(**source)  # type: ignore[arg-type]


@pytest.mark.parametrize("preset", PRESETS)
def test_a_resolved_configuration_reproduces_itself(preset: str, tmp_path: Path) -> None:
    config = load_config(preset)
    assert load_config(file=written(tmp_path, render_toml(config))) == config


@pytest.mark.parametrize("preset", [preset for preset in PRESETS if preset != "levy-klein"])
def test_presets_by_grade_take_the_acceleration_noise_from_the_dvl(preset: str) -> None:
    filters = load_config(preset).filters
    acceleration = filters["aided"].acceleration
    assert acceleration is not None
    assert acceleration.sd_mps2 is None
    assert {filter_.gate_probability for filter_ in filters.values()} == {0.99999}


def test_presets_grow_noisier_from_grade_to_grade() -> None:
    noises = [load_config(preset).noise for preset in ("fog", "tactical", "mems")]
    for key in (
        "accel_white_mps_rts",
        "gyro_white_rad_rts",
        "accel_bias_walk_mps2_rts",
        "gyro_bias_walk_radps_rts",
    ):
        values = [getattr(noise, key) for noise in noises]
        assert values == sorted(values), key
    assert len({noise.gyro_white_rad_rts for noise in noises}) == len(noises)


@example(scale=1.0, lever=(0.0, 0.0, 0.0), topic='\x7f\x1f\n"\\é')
@given(
    scale=st.floats(min_value=1e-6, max_value=1e6),
    lever=st.tuples(*[st.floats(-1e300, 1e300)] * 3),
    topic=st.none() | st.text(st.characters(exclude_categories=["Cs"])),
)
def test_any_value_survives_being_written_as_toml(
    scale: float, lever: tuple[float, float, float], topic: str | None
) -> None:
    config = Config(dvl=Dvl(scale=scale, lever_arm_m=lever, topic=topic))
    assert msgspec.convert(tomllib.loads(render_toml(config)), Config) == config


@pytest.mark.parametrize(
    ("text", "key", "value", "hint"),
    [
        ("[dvl]\nscle = 1.0", ": ", "'dvl.scle'", "dvl.scale"),
        ("[dlv]\nscale = 1.0", ": ", "'dlv'", "dvl"),
        ('[filters.a]\naidin = ["velocity"]', ": ", "'filters.a.aidin'", "filters.a.aiding"),
        ("dvl = 3", ": dvl ", "3", "[dvl]"),
        ("[filters]\na = 3", ": filters.a ", "3", "[filters.a]"),
        ('[dvl]\nlever_arm_m = [0.0, "x", 0.0]', ": dvl.lever_arm_m[1]: ", "'x'", ""),
        ("[dvl]\nscale = 0", ": dvl.scale: ", "0", ""),
        ("[dvl]\nlever_arm_m = [0, 0, inf]", ": dvl.lever_arm_m[2] ", "inf", ""),
        ('[filters.a-b]\naiding = ["velocity"]', ": filter", "'a-b'", ""),
        (
            f"{RUN}solution = {{ tpic = '/o' }}",
            ": ",
            "'filters.b.solution.tpic'",
            "filters.b.solution.topic",
        ),
    ],
)
def test_a_error_in_a_file_is_reported_with_place_and_hint(
    text: str, key: str, value: str, hint: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(file=written(tmp_path, text))
    assert caught.value.message.startswith(f"{tmp_path / 'vehicle.toml'}{key}")
    assert value in caught.value.message
    assert hint in caught.value.hint


@pytest.mark.parametrize(
    "override", ["dvl.scale", "scale=3", "dvl.scle=3", "dvl.kind=boat", "dvl.scale=nan"]
)
def test_a_error_on_the_command_line_is_reported_with_its_own_words(override: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=["dvl.scale=1.5", override])
    assert caught.value.message.startswith(f"--set {override}: ")
    assert caught.value.hint


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("dvl.axes = 'frd'\ndvl.kind = 'beam'", ": dvl.kind 'beam' "),
        ("[filters.a]\naiding = ['velocity', 'accel']", ": filters.a.aiding[1] 'accel' "),
        ("[dvl]\n\n'scale - at `$.kind`' = 1", ": key 'dvl.scale - at `$.kind`' "),
    ],
)
def test_a_error_in_a_file_is_reported_with_its_key(text: str, place: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(file=written(tmp_path, text))
    assert caught.value.message.startswith(f"{tmp_path / 'vehicle.toml'}{place}")


def test_a_state_is_reported_by_a_sensor_that_is_held_out_too(tmp_path: Path) -> None:
    """How far a filter's depth may differ from a gauge hangs on the zero of the gauge."""
    path = tmp_path / "vehicle.toml"
    text = '[filters.a]\naiding = ["velocity"]\nstates = ["position", "depth_zero"]\n'
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"filters\.a .*depth_zero"):
        load_config(None, path, [])
    path.write_text(f'{text}[evaluation]\nheld_out = ["depth"]\n')
    assert load_config(None, path, []).filters["a"].states == ("position", "depth_zero")


def test_a_mistyped_word_is_reported_the_nearest_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(file=written(tmp_path, '[dvl]\nkind = "beam"'))
    assert "beams" in caught.value.hint


@pytest.mark.parametrize(
    ("override", "meant"),
    [
        ("dvl.velocity_noise=0.01", "dvl.velocity_sd_mps"),  # by letters dvl.velocity_unit
        ("dvl.noise=0.01", "dvl.beam_sd_mps or dvl.velocity_sd_mps"),
        ("dvl.velocity_unti='m/s'", "dvl.velocity_unit"),
        ("dvl.delay_s=0.1", "dvl.latency_s or dvl.latency_of_dives_s"),
        ("imu.gyro_noise=1e-3", "noise.gyro_white_rad_rts"),
        ("dvl.starts=4", "evaluation.starts"),
        ("filters.aided.window=4", "filters.aided.acceleration.window"),
        ("gps.topic='/fix'", "position"),
    ],
)
def test_a_key_that_is_not_known_is_reported_the_one_that_was_meant(
    override: str, meant: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=[override])
    assert f" {meant}?" in caught.value.hint


@pytest.mark.parametrize(
    ("override", "taken"),
    [
        ("evaluation.held_out=position", 'evaluation.held_out=["position"]'),
        (
            "evaluation.held_out=[position,depth]",
            'evaluation.held_out=["position", "depth"]',
        ),  # what a shell leaves
        ("dvl.lever_arm_m=1,2,0.5", "dvl.lever_arm_m=[1.0, 2.0, 0.5]"),
        ("dvl.lever_arm_m=1", "dvl.lever_arm_m=[0.0, 0.0, 0.0]"),
        ("dvl.lever_arm_m=[1, 2]", "dvl.lever_arm_m=[0.0, 0.0, 0.0]"),
    ],
)
def test_what_is_no_list_is_reported_how_one_is_written(override: str, taken: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=[override])
    assert f"--set '{taken}'" in caught.value.hint
    load_config(overrides=[taken])


def test_a_list_in_a_file_is_written_as_toml(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(file=written(tmp_path, '[evaluation]\nheld_out = "depth"'))
    assert 'evaluation.held_out = ["depth"]' in caught.value.hint


def test_a_word_that_is_not_known_is_reported_where_it_was_said(tmp_path: Path) -> None:
    file = written(tmp_path, f"[evaluation]\nheld_out = ['gps']\n{RUN}aiding = ['speed']")
    with pytest.raises(ConfigError, match=r"vehicle.toml: evaluation.held_out\[0\] 'gps'"):
        load_config(file=file)
    with pytest.raises(ConfigError, match=r"vehicle.toml: filters.b.aiding\[0\] 'speed'"):
        load_config(file=file, overrides=["evaluation.held_out=[]"])
    with pytest.raises(ConfigError, match=r"^--set .*: filters.b.aiding\[0\] 'beam'"):
        load_config(file=file, overrides=["evaluation.held_out=[]", 'filters.b.aiding=["beam"]'])


def test_overrides_that_only_fit_together_are_taken_together() -> None:
    config = load_config(
        overrides=["filters.aided.acceleration.order=3", "filters.aided.acceleration.window=5"]
    )
    acceleration = config.filters["aided"].acceleration
    assert isinstance(acceleration, Acceleration)
    assert (acceleration.order, acceleration.window) == (3, 5)


def test_none_leaves_a_setting_out_as_results_write_it() -> None:
    config = load_config(overrides=["dvl.beam_sd_mps=0.01"], against=["dvl.beam_sd_mps=none"])
    assert config.dvl.beam_sd_mps is None
    assert load_config(overrides=["dvl.beam_sd_mps=0.01"]).dvl.beam_sd_mps == 0.01


def test_a_bare_word_is_a_string() -> None:
    assert load_config(overrides=["imu.axes=flu"]).imu.axes == "flu"


def test_unknown_preset_is_reported_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="'phog'") as caught:
        load_config("phog")
    assert "fog" in caught.value.hint


def test_unreadable_files_are_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.toml: "):
        load_config(file=tmp_path / "absent.toml")
    (tmp_path / "image.toml").write_bytes(b"\x89PNG\xff")
    with pytest.raises(ConfigError, match="UTF-8"):
        load_config(file=tmp_path / "image.toml")


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        (f"dvl.scale={'9' * 5000}", "dvl.scale: .*'999"),
        (f"dvl.scale={'9' * 4000}", "dvl.scale: "),
        (f"dvl.scale={'[' * 5000}", r"dvl.scale: .*'\[\[\["),
        ("dvl.velocity_sd_mps=1e308", r"dvl.velocity_sd_mps .*1e\+30, .*1e\+308"),
        ("dvl.topic=\udcff", "UTF-8"),
    ],
)
def test_numbers_and_words_beyond_all_measure_are_errors_of_the_user(
    setting: str, value: str
) -> None:
    with pytest.raises(ConfigError, match=value):
        load_config(overrides=[setting])


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000])
def test_a_file_beyond_all_measure_is_not_valid(value: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"vehicle.toml: .*TOML"):
        load_config(file=written(tmp_path, f"[dvl]\nscale = {value}\n"))


def test_a_file_next_to_the_settings_is_found_again_and_held_fast(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Resolved settings lie in a result folder; there the file is another one if a byte of it has changed."""
    (tmp_path / "there").mkdir()
    onboard = tmp_path / "there" / "flown.tum"
    onboard.write_text("0 0 0 0 0 0 0 1\n")
    file = written(tmp_path / "there", f'{RUN}solution = "flown.tum"\n')
    monkeypatch.chdir(tmp_path)
    config = load_config(file=file.relative_to(tmp_path))
    (solution,) = config.solutions.values()
    assert (solution.file, solution.topic) == (str(onboard), None)
    resolved = written(tmp_path, render_toml(config))
    assert load_config(file=resolved) == config
    onboard.write_text("0 0 0 0 0 0 0 2\n")
    assert load_config(file=file) != config
    with pytest.raises(ConfigError, match=r"flown\.tum"):
        load_config(file=resolved)


def test_a_name_is_a_topic_or_by_its_ending_a_file_and_keys_can_be_added(tmp_path: Path) -> None:
    file = written(tmp_path, f'{RUN}solution = "/odometry"\n')
    (solution,) = load_config(
        file=file, overrides=["filters.b.solution.align=heading"]
    ).solutions.values()
    assert (solution.topic, solution.align) == ("/odometry", "heading")
    config = load_config(file=file)
    assert list(config.computed) == ["a"]
    assert 'solution = "/odometry"' in render_toml(config)
    assert (
        "gate_probability" not in render_toml(config).partition("[filters.b]")[2]
    )  # what it has not is not shown


@pytest.mark.parametrize(
    ("setting", "hint"),
    [
        ("dvl.lever_arm_m=[300,0,0]", "300 mm are 0.3"),
        ("reference.lever_arm_m=[0,-1834,95]", "-1834 mm are -1.834"),
        ("depth.lever_arm_m=[0,0,50.1]", "metres"),
        ("position.lever_arm_m=[0,60,0]", "metres"),
        ("dvl.mounting_rpy_deg=[0,0,5730]", "from -360 to 360"),
        ("heading.mounting_rpy_deg=[361,0,0]", "degrees"),
        ("initial.heading_deg=-361", "degrees"),
    ],
)
def test_lengths_and_angles_that_no_vehicle_has_are_refused(setting: str, hint: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        load_config(overrides=[setting])
    assert refusal.value.where == (f"--set {setting}",)
    assert refusal.value.what.startswith(setting.partition("=")[0])
    assert hint in refusal.value.hint


def test_the_largest_lengths_and_angles_are_settings() -> None:
    load_config(overrides=["dvl.lever_arm_m=[-50,50,0]", "dvl.mounting_rpy_deg=[360,-360,0]"])
