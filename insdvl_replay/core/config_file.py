"""Settings from TOML and back: strict, so that a mistyped key is an error that names the nearest known one.

Precedence: defaults, then preset, then files in their order, then command line.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from tomllib import TOMLDecodeError
from typing import Annotated, Any, Final, get_origin, get_type_hints

import msgspec
from msgspec import Struct

from insdvl_replay.core.config import MOST_BYTES, Config, Filter, Solution, Topic, key_of, spelled_out
from insdvl_replay.core.config_checks import check_filters, check_finite, refuse_code
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.plain_text import is_writable, read_regular, visible
from insdvl_replay.core.strict_toml import TomlSource, parse_toml, read_toml

_HINT: Final = "`insdvl-replay config` prints every key with its kind and unit"
_OVERRIDE: Final = "for example --set dvl.scale=1.01"
PRESETS = ("levy-klein", "fog", "tactical", "mems")


def load_config(
    preset: str | None = None,
    file: Path | Sequence[Path] | None = None,
    overrides: Sequence[str] = (),
    *,
    allow_code: bool = False,
) -> Config:
    """Resolve the settings: defaults < preset < file < overrides.

    Parameters
    ----------
    preset : str, optional
        One of `PRESETS`.
    file : Path or sequence of Path, optional
        TOML; of several, later ones lie over earlier ones. A file with a ``[filters]`` section names all filters; other
        keys change one setting each.
    overrides : sequence of str
        ``section.key=value`` with a TOML value; a bare word is taken as a string.
    allow_code : bool
        The settings may name code, as ``module:Class``. Nothing is imported here.

    Raises
    ------
    ConfigError
        Unknown preset, unreadable file, unknown key (with the nearest known one), value of the wrong kind or range,
        code that is not allowed.
    """
    layers = [_read_preset(preset or PRESETS[0])]
    settings = _overlaid(msgspec.to_builtins(Config()), layers[0])
    for path in [file] if isinstance(file, Path) else file or ():
        laid = read_toml(
            path,
            _HINT,
            if_unreadable="check the path given to -c",
            if_invalid="`insdvl-replay config` prints a valid one",
        )
        laid = replace(laid, content=_with_whole_paths(laid.content, path.parent))
        settings = _overlaid(settings, laid)
        layers.append(laid)
    set_alone = [_parse_override(text) for text in overrides]
    config = _with_overrides(settings, set_alone)
    check_filters(config, [*layers, *set_alone])
    if not allow_code:
        refuse_code(config, [*layers, *set_alone])
    return _with_digests(config)


def _with_whole_paths(content: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Let the files that filters name be found from wherever the settings are read again."""
    filters = content.get("filters")
    if not isinstance(filters, Mapping):
        return content
    return {**content, "filters": {name: _with_whole_path(entry, folder) for name, entry in filters.items()}}


def _with_whole_path(entry: Any, folder: Path) -> Any:
    solution = entry.get("solution") if isinstance(entry, Mapping) else None
    if isinstance(solution, str) and key_of(solution) == "file":
        return {**entry, "solution": str((folder / solution).absolute())}
    if isinstance(solution, Mapping) and isinstance(file := solution.get("file"), str):
        return {**entry, "solution": {**solution, "file": str((folder / file).absolute())}}
    return entry


def _with_digests(config: Config) -> Config:
    """Hold fast which files are meant: settings that name another one are others."""
    filters = {}
    for name, filter_ in config.filters.items():
        if filter_.solution is not None and (solution := spelled_out(filter_.solution)).file is not None:
            solution = _with_digest(solution, f"filters.{name}.solution")
            filter_ = msgspec.structs.replace(filter_, solution=solution)
        filters[name] = filter_
    return msgspec.structs.replace(config, filters=filters)


def _with_digest(solution: Solution, key: str) -> Solution:
    try:
        sha256 = hashlib.sha256(read_regular(Path(solution.file or ""), MOST_BYTES)).hexdigest()
    except OSError as error:
        raise ConfigError(
            f"{key}: {solution.file}: cannot be read: {error.strerror}", "a path counts from the settings' own folder"
        ) from error
    if solution.sha256 not in (None, sha256):
        raise ConfigError(
            f"{key}: {solution.file} is not the file that was meant: its SHA-256 is {sha256}",
            f"leave {key}.sha256 out, and it is taken as it is",
        )
    return msgspec.structs.replace(solution, file=str(Path(solution.file or "").absolute()), sha256=sha256)


def _overlaid(settings: Mapping[str, Any], source: TomlSource) -> dict[str, Any]:
    """Lay a file over the settings; if it names filters, they are all there are."""
    kept = {key: value for key, value in settings.items() if key != "filters" or "filters" not in source.content}
    merged = _merged(kept, source.content)
    _converted(merged, source)
    return merged


def _with_overrides(settings: Mapping[str, Any], overrides: Sequence[TomlSource]) -> Config:
    """Apply all overrides, then convert: two of them may make a filter that neither makes alone."""
    changed = dict(settings)
    for override in overrides:
        changed = _merged(changed, override.content)
    try:
        return _converted(changed, TomlSource("the configuration", _HINT))
    except ConfigError:
        for override in overrides:  # says which one it was
            settings = _merged(settings, override.content)
            _converted(settings, override)
        raise


def _read_preset(name: str) -> TomlSource:
    if name not in PRESETS:
        raise ConfigError(f"preset '{name}' is not known", f"use one of: {', '.join(PRESETS)}")
    text = resources.files("insdvl_replay").joinpath("presets", f"{name}.toml").read_text("utf-8")
    return TomlSource(f"preset {name}", _HINT, parse_toml(text))


def _parse_override(text: str) -> TomlSource:
    path, equals, value = text.partition("=")
    keys = path.strip().split(".")
    if not equals or not all(keys) or len(keys) < 2:
        raise ConfigError(f"--set {text}: is not of the form section.key=value", _OVERRIDE)
    if not is_writable(text):
        raise ConfigError(f"--set {text}: is not UTF-8 text", _OVERRIDE)
    try:
        parsed: Any = parse_toml(f"value = {value.strip()}")["value"]
    except TOMLDecodeError:
        parsed = value.strip()
    for key in reversed(keys):
        parsed = {key: parsed}
    return TomlSource(f"--set {text}", _HINT, parsed, assigned="--set '{}={}'")


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        if key == "solution" and isinstance(old, str):
            old = {key_of(old): old}
        merged[key] = _merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged


def _converted(settings: Mapping[str, Any], source: TomlSource) -> Config:
    """Check kinds and ranges. Filters and topics are converted one by one, so that a message can name its own."""
    for section, kind in (("filters", Filter), ("topics", Topic)):
        entries = settings.get(section)
        if isinstance(entries, Mapping):
            of_each = {name: source.inside(section, name).converted(entry, kind) for name, entry in entries.items()}
            settings = {**settings, section: of_each}
    config = source.converted(settings, Config)
    check_finite(msgspec.to_builtins(config), source, ())
    return config


def render_toml(config: Config) -> str:
    """Write the settings as commented TOML; reading it back gives the same. Keys that are left out are comments."""
    return "\n".join(_toml_lines(config, "")).strip() + "\n"


def _toml_lines(section: Struct, path: str) -> Iterator[str]:
    hints = get_type_hints(type(section), include_extras=True)
    tables: list[tuple[str, Struct]] = []
    is_read = isinstance(section, Filter) and section.solution is not None
    for name in ("solution",) if is_read else section.__struct_fields__:
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
    """Write a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # A JSON string is one in TOML too, but for the one control character that JSON leaves as it is.
        return visible(msgspec.json.encode(value).decode().replace("\x7f", "\\u007f"))
    if isinstance(value, tuple | list):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(value)
