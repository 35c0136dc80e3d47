"""What settings have to be beyond their kinds: finite, known words, filters that make sense."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Final

from insdvl_replay.core.config import TOPIC_KEYS, Config, Filter, spelled_out
from insdvl_replay.core.errors import ConfigError, error_context, require_known
from insdvl_replay.core.states import AIDING, DVL_AIDING, MORE_STATES, SENSORS
from insdvl_replay.core.strict_toml import KeyPath, TomlSource

LARGEST = 1e30
"""Nothing that is measured is larger, and powers of what is smaller are still numbers."""
_TOLD_BY: Final = {
    "dvl_scale": DVL_AIDING,
    "dvl_yaw": DVL_AIDING,
    "depth_zero": ("depth",),
    "heading_bias": ("heading",),
}
"""Words in a filter's aiding, or sensors that are withheld, by states of which nothing else tells."""


def check_finite(value: object, source: TomlSource, path: KeyPath) -> None:
    """Require that every number is finite, and none so large that its powers are not.

    Raises
    ------
    ConfigError
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(
            f"{source.where(*path)}: {source.key(*path)} must be a finite number, found {value}",
            "leave out what is not limited",
        )
    if isinstance(value, float | int) and abs(value) > LARGEST:
        raise ConfigError(
            f"{source.where(*path)}: {source.key(*path)} must be at most {LARGEST:.0e}, found {value}",
            "`insdvl-replay config` prints its unit",
        )
    entries: Iterable[tuple[Any, object]] = ()
    if isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, list | tuple):
        entries = enumerate(value)
    for key, entry in entries:
        check_finite(entry, source, (*path, key))


def check_filters(config: Config, layers: Sequence[TomlSource]) -> None:
    """Require known words, names that can be part of topics, and filters that make sense.

    Parameters
    ----------
    layers : sequence of TomlSource
        Of which the settings are made, the first one lowest: a message names the last that says what is wrong.

    Raises
    ------
    ConfigError
    """
    _check_words(config.evaluation.withheld, SENSORS, layers, "evaluation", "withheld")
    if not config.filters:
        raise ConfigError(
            f"{_said_last(layers, 'filters').where()}: no filter is configured",
            'add [filters.baseline] with aiding = ["velocity"]',
        )
    for name in config.topics:
        if not (name.isascii() and name.isidentifier()):
            raise ConfigError(
                f"the topic's name '{name}' is not a letter followed by letters, digits and _",
                '[topics.range] topic = "/range", values = "range"',
            )
    for name, filter_ in config.filters.items():
        where = _said_last(layers, "filters", name).where("filters", name)
        if not (name.isascii() and name.isidentifier()):
            raise ConfigError(
                f"{where}: filter name '{name}' is not a letter followed by letters, digits and _",
                "the name becomes part of topics and rows",
            )
        own = [word for word in filter_.aiding if ":" in word]
        _check_words(filter_.aiding, (*AIDING, "module:Class", *own), layers, "filters", name, "aiding")
        _check_words(filter_.states, MORE_STATES, layers, "filters", name, "states")
        if filter_.solution is None:
            _check_filter(filter_, config.evaluation.withheld, f"filters.{name}", where)
        else:
            _check_solution(filter_, f"filters.{name}", where, is_baseline=name == config.baseline)


def refuse_code(config: Config, layers: Sequence[TomlSource]) -> None:
    """Refuse settings that name code to run.

    Raises
    ------
    ConfigError
    """
    for name, filter_ in config.filters.items():
        for place, word in enumerate(filter_.aiding):
            if ":" in word:
                path = ("filters", name, "aiding")
                source = _said_last(layers, *path)
                raise ConfigError(
                    f"{source.where(*path, place)}: {source.key(*path, place)} names code: {word}",
                    "`run`, `check` and `calibrate` take --allow-code, which runs it with your rights",
                )


def _said_last(layers: Sequence[TomlSource], *path: str) -> TomlSource:
    """Find whose word counts; what none of them says is a default, and goes by no name of a file."""
    return next((layer for layer in reversed(layers) if layer.says(*path)), TomlSource("the configuration", ""))


def _check_words(words: Sequence[str], known: Collection[str], layers: Sequence[TomlSource], *path: str) -> None:
    """Require that a list names what is known, and nothing twice."""
    source = _said_last(layers, *path)
    for place, word in enumerate(words):
        with error_context(source.where(*path, place)):
            require_known(source.key(*path, place), word, known)
            if word in words[:place]:
                raise ConfigError(f"{source.key(*path, place)} '{word}' stands there already", "leave one of them out")


def _check_solution(filter_: Filter, key: str, where: str, *, is_baseline: bool) -> None:
    """Require that a solution that is read stands behind a filter that is run, and has nothing of one itself."""
    if is_baseline:
        raise ConfigError(
            f"{where}: {key}.solution is read, and cannot be the baseline: from its start all others begin",
            'name a filter first that is run, such as [filters.baseline] with aiding = ["velocity"]',
        )
    default = Filter()
    others = [name for name in Filter.__struct_fields__ if getattr(filter_, name) != getattr(default, name)]
    if len(others) > 1:
        names = " and ".join(f"{key}.{name}" for name in others if name != "solution")
        raise ConfigError(f"{where}: {key}.solution is read and not run, and {names} says how", "leave one of them out")
    solution = spelled_out(filter_.solution or "")
    if (solution.topic is None) == (solution.file is None):
        found = "names nothing" if solution.topic is None else "names a topic and a file"
        raise ConfigError(f"{where}: {key}.solution {found}", 'solution = "/odometry", or solution = "onboard.tum"')
    read_from_topic = [name for name in ("fix", *TOPIC_KEYS) if getattr(solution, name) is not None]
    if solution.file is not None and read_from_topic:
        raise ConfigError(
            f"{where}: {key}.solution is a file, of which {key}.solution.{read_from_topic[0]} says nothing",
            "time x y z qx qy qz qw stand in each line, and solution.axes says in which axes",
        )


def _check_filter(filter_: Filter, withheld: Sequence[str], key: str, where: str) -> None:
    if not filter_.aiding:
        raise ConfigError(f"{where}: {key}.aiding names nothing", 'aiding = ["velocity"]')
    if {"velocity", "beams"} <= set(filter_.aiding):
        raise ConfigError(
            f"{where}: {key} is told of every ping twice, by its velocity and its beams", 'aiding = ["beams"]'
        )
    acceleration = filter_.acceleration
    if "acceleration" in filter_.aiding and acceleration is None:
        raise ConfigError(
            f"{where}: {key} is aided by acceleration but does not say how",
            f'[{key}] acceleration = {{ model = "windowed", window = 3 }}',
        )
    for state in filter_.states:
        if not set(_TOLD_BY.get(state, filter_.aiding)) & {*filter_.aiding, *withheld}:
            raise ConfigError(
                f"{where}: {key} estimates {state}, and is aided by nothing that tells it",
                f"{key}.aiding with {' or '.join(_TOLD_BY[state])}, or {key}.states without {state}",
            )
    if acceleration is not None and acceleration.order >= acceleration.window:
        raise ConfigError(
            f"{where}: {key}.acceleration.order = {acceleration.order} needs a window above "
            f"{acceleration.order}, found {acceleration.window}",
            f"window = {acceleration.order + 1}",
        )
