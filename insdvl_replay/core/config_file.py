"""Settings from TOML and back: strict, so that a mistyped key is an error that names the nearest known one.

Precedence: defaults, then preset, then file, then command line.
"""

import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Struct

from insdvl_replay.core.config import Config, Filter
from insdvl_replay.core.errors import ConfigError, nearest
from insdvl_replay.core.plain_text import is_writable, visible
from insdvl_replay.core.text_files import read_text
from insdvl_replay.core.toml_text import parsed_toml

_SHOWN = 80
"""Letters of a wrong value that a message repeats."""
Section = TypeVar("Section", Config, Filter)

LARGEST = 1e30
"""Nothing that is measured is larger, and powers of what is smaller are still numbers."""
PRESETS = ("levy-klein", "fog", "tactical", "mems")


def load_config(preset: str | None = None, file: Path | None = None, overrides: Sequence[str] = ()) -> Config:
    """Resolve the settings: defaults < preset < file < overrides.

    Parameters
    ----------
    preset : str, optional
        One of `PRESETS`.
    file : Path, optional
        TOML. A file with a ``[filters]`` section names all filters; other keys change one setting each.
    overrides : sequence of str
        ``section.key=value`` with a TOML value; a bare word is taken as a string.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        Unknown preset, unreadable file, unknown key (with the nearest known one), value of the wrong kind or range.
    """
    settings: dict[str, Any] = msgspec.to_builtins(Config())
    preset = preset or PRESETS[0]
    settings = _overlaid(settings, _read_preset(preset), f"preset {preset}")
    if file is not None:
        settings = _overlaid(settings, _read_toml(file), str(file))
    changes = [_parse_override(text) for text in overrides]
    for text, change in zip(overrides, changes, strict=True):
        _check_keys(change, where=f"--set {text}")
    config = _with_overrides(settings, dict(zip(overrides, changes, strict=True)))
    _check_filters(config, where="the configuration")
    return config


def _with_overrides(settings: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]]) -> Config:
    """Apply all overrides, then convert: two of them may make a filter that neither makes alone."""
    changed = dict(settings)
    for change in changes.values():
        changed = _merged(changed, change)
    try:
        return _converted(changed, where="the configuration")
    except ConfigError:
        for text, change in changes.items():  # says which one it was
            settings = _merged(settings, change)
            _converted(settings, where=f"--set {text}")
        raise


def _overlaid(settings: Mapping[str, Any], changes: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Lay a file over the settings; if it names filters, they are all there are."""
    _check_keys(changes, where)
    kept = {key: value for key, value in settings.items() if key != "filters" or "filters" not in changes}
    merged = _merged(kept, changes)
    _converted(merged, where)
    return merged


def _read_preset(name: str) -> dict[str, Any]:
    if name not in PRESETS:
        raise ConfigError(f"preset '{name}' is not known", f"use one of: {', '.join(PRESETS)}")
    return tomllib.loads(resources.files("insdvl_replay").joinpath("presets", f"{name}.toml").read_text("utf-8"))


def _read_toml(file: Path) -> dict[str, Any]:
    try:
        return parsed_toml(read_text(file))
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}", "check the path given to -c") from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{file}: is not UTF-8 text (byte {error.start})", "a configuration is a TOML file"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{file}: is not valid TOML: {error}", "`insdvl-replay config` prints a valid one") from error


def _parse_override(text: str) -> dict[str, Any]:
    path, equals, value = text.partition("=")
    keys = path.strip().split(".")
    if not equals or not all(keys) or len(keys) < 2:
        raise ConfigError(f"--set {text}: is not of the form section.key=value", "for example --set dvl.scale=1.01")
    if not is_writable(text):
        raise ConfigError(f"--set {text}: is not UTF-8 text", "for example --set dvl.scale=1.01")
    try:
        parsed: Any = parsed_toml(f"value = {value.strip()}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    for key in reversed(keys):
        parsed = {key: parsed}
    return dict(parsed)


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        merged[key] = _merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged


def _section_types(struct: type[Struct]) -> dict[str, type[Struct]]:
    """Find the tables inside a table, each with the structure of its keys; ``*`` stands for any name."""
    sections = {}
    for name, hint in get_type_hints(struct).items():
        if get_origin(hint) is dict:
            sections[name] = hint
        for candidate in (hint, *get_args(hint)):
            if isinstance(candidate, type) and issubclass(candidate, Struct) and get_origin(hint) is not dict:
                sections[name] = candidate
    return sections


def _check_keys(settings: Mapping[str, Any], where: str, struct: type[Struct] = Config, path: str = "") -> None:
    """Refuse unknown keys, naming the nearest known one."""
    sections = _section_types(struct)
    known = struct.__struct_fields__
    for key, value in settings.items():
        if key not in known:
            meant = nearest(key, known)
            hint = f"did you mean {path}{meant}?" if meant else f"known here: {', '.join(known)}"
            raise ConfigError(f"{where}: unknown key {path}{key}", hint)
        inner = sections.get(key)
        if inner is None:
            continue
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where}: {path}{key} is a section, found {value!r}", f"write [{path}{key}]")
        if get_origin(inner) is dict:
            for name, entry in value.items():
                if isinstance(entry, Mapping):
                    _check_keys(entry, where, get_args(inner)[1], f"{path}{key}.{name}.")
        else:
            _check_keys(value, where, inner, f"{path}{key}.")


def _converted(settings: Mapping[str, Any], where: str) -> Config:
    """Check kinds and ranges. Filters are checked one by one, so that an error can name its filter."""
    filters = {
        name: _checked(entry, Filter, where, f"filters.{name}") for name, entry in settings.get("filters", {}).items()
    }
    rest = {key: value for key, value in settings.items() if key != "filters"}
    return msgspec.structs.replace(_checked(rest, Config, where, ""), filters=filters)


def _checked(section: object, kind: type[Section], where: str, path: str) -> Section:
    try:
        converted = msgspec.convert(section, kind)
    except msgspec.ValidationError as error:
        sentence, _, place = str(error).partition(" - at `$")
        place = place.rstrip("`")
        key = f"{path}{place}".lstrip(".") or "the top level"
        raise ConfigError(
            f"{where}: {key}: {sentence[0].lower()}{sentence[1:]}{_found(section, place)}",
            "`insdvl-replay config` prints every key with its kind and unit",
        ) from error
    _check_finite(section, where, path)
    return converted


def _found(section: object, place: str) -> str:
    value: Any = section
    for part in re.findall(r"\w+", place):
        value = value[int(part)] if isinstance(value, list | tuple) else value[part]
    return f", found {_short(repr(value))}" if place else ""


def _check_finite(value: object, where: str, path: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{where}: {path} must be a finite number, found {value}", "leave out what is not limited")
    if isinstance(value, float | int) and abs(value) > LARGEST:
        raise ConfigError(
            f"{where}: {path} must be at most {LARGEST:.0e}, found {value}", "`insdvl-replay config` prints its unit"
        )
    entries: Iterable[tuple[object, object]] = ()
    if isinstance(value, Mapping):
        entries = ((f"{path}.{key}".lstrip("."), entry) for key, entry in value.items())
    elif isinstance(value, list | tuple):
        entries = ((f"{path}[{index}]", entry) for index, entry in enumerate(value))
    for entry_path, entry in entries:
        _check_finite(entry, where, str(entry_path))


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _check_filters(config: Config, where: str) -> None:
    if not config.filters:
        raise ConfigError(f"{where}: no filter is configured", 'add [filters.baseline] with aiding = ["velocity"]')
    for name, filter_ in config.filters.items():
        if not (name.isascii() and name.isidentifier()):
            raise ConfigError(
                f"{where}: filter name '{name}' is not a letter followed by letters, digits and _",
                "the name becomes part of topics and rows",
            )
        if not filter_.aiding or len(set(filter_.aiding)) != len(filter_.aiding):
            raise ConfigError(
                f"{where}: filters.{name}.aiding names a measurement twice or none", 'aiding = ["velocity"]'
            )
        acceleration = filter_.acceleration
        if "acceleration" in filter_.aiding and acceleration is None:
            raise ConfigError(
                f"{where}: filters.{name} is aided by acceleration but does not say how",
                f'[filters.{name}] acceleration = {{ model = "windowed", window = 3 }}',
            )
        if acceleration is not None and acceleration.order >= acceleration.window:
            raise ConfigError(
                f"{where}: filters.{name}.acceleration.order = {acceleration.order} needs a window above "
                f"{acceleration.order}, found {acceleration.window}",
                f"window = {acceleration.order + 1}",
            )


def render_toml(config: Config) -> str:
    """Write the settings as commented TOML; reading it back gives the same settings.

    Parameters
    ----------
    config : Config

    Returns
    -------
    str
        Keys that are left out stand as comments.
    """
    return "\n".join(_toml_lines(config, "")).strip() + "\n"


def _toml_lines(section: Struct, path: str) -> Iterator[str]:
    hints = get_type_hints(type(section), include_extras=True)
    tables: list[tuple[str, Struct]] = []
    for name in section.__struct_fields__:
        value = getattr(section, name)
        if isinstance(value, Struct):
            tables.append((f"{path}{name}", value))
        elif isinstance(value, dict):
            tables += [(f"{path}{name}.{key}", entry) for key, entry in value.items()]
        elif name in hints and get_origin(hints[name]) is Annotated:
            yield _toml_key(name, value, hints[name].__metadata__[-1].description)
    for table_path, table in tables:
        yield f"\n[{table_path}]"
        yield from _toml_lines(table, f"{table_path}.")


def _toml_key(name: str, value: object, comment: str) -> str:
    text = f"# {name} =" if value is None else f"{name} = {toml_value(value)}"
    return f"{text:<40}  # {comment}"


def toml_value(value: object) -> str:
    """Write a value as TOML.

    Parameters
    ----------
    value : bool, str, float, or tuple or list of them

    Returns
    -------
    str
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # A JSON string is one in TOML too, but for the one control character that JSON leaves as it is.
        return visible(msgspec.json.encode(value).decode().replace("\x7f", "\\u007f"))
    if isinstance(value, tuple | list):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(value)
