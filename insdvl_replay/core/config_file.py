"""Settings from TOML and back: layers, error messages, checks across keys, and commented TOML.

Precedence: defaults, then preset, then files in their order, then command line.
"""

import hashlib
import math
import re
import shlex
import stat
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import EnumMeta
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Struct

from insdvl_replay.core.config import (
    FREE,
    MOST_BYTES,
    Config,
    ConfigFile,
    Filter,
    Found,
    Initial,
    Topic,
    flattened,
    key_of,
)
from insdvl_replay.core.config_checks import (
    KeyPath,
    candidate_keys,
    code_problems,
    dotted,
    problems,
)
from insdvl_replay.core.errors import (
    LISTED,
    ConfigError,
    LogError,
    error_context,
    hint_for,
    is_writable,
    listed,
    most_like,
    nearest,
    read_regular,
    read_text,
    require_known,
    visible,
)
from insdvl_replay.core.path_kinds import looks_like_log, require_kind_of_toml

S = TypeVar("S", bound=Struct)

PRESETS: Final = ("levy-klein", "fog", "tactical", "mems")
# The preset whose filters are used with a fitted noise; those of the other classes are the same.
FITTED_LIKE: Final = "fog"
FOUND: Final = "found"  # the table of a file of found settings that sets nothing
SECTIONS: Final = frozenset(ConfigFile.__struct_fields__)
SCHEMA_FILE: Final = (
    "insdvl-replay.schema.json"  # that editors look for, next to a file of settings
)
SCHEMA_LINE: Final = f"#:schema ./{SCHEMA_FILE}\n"
"""First line of each file of settings that is written for people. Editors know by it which keys there are."""
LARGEST: Final = 1e30  # No measured value is larger, and powers of smaller values do not overflow.
_HINT: Final = "`insdvl-replay config` prints all keys with type and unit"
_IF_UNREADABLE: Final = "check the path given to -c"
_IF_INVALID: Final = "`insdvl-replay config` prints a valid one"
_IF_UNNAMED: Final = "mend it, name other settings with -c, or use none with --no-config"
_LONGEST_SHOWN: Final = 80  # letters of a wrong value
# Similarity from which a name is surely a misspelling, whatever other names share words with it.
_MISSPELLED: Final = 0.85
_ALSO_CALLED: Final[Mapping[str, str]] = {
    "noise": "sd white", "std": "sd", "stddev": "sd", "sigma": "sd", "delay": "latency", "lag": "latency",
    "offset": "lever arm", "mount": "mounting", "misalignment": "mounting", "gps": "position", "gnss": "position",
    "usbl": "position", "compass": "heading", "ahrs": "heading", "pressure": "depth",
}  # fmt: skip
_UNITS: Final = frozenset(
    ["m", "s", "deg", "rad", "pct", "hz", "mg", "mps", "mps2", "radps", "degph", "degps", "rts"]
)
_KINDS: Final = {
    "float": "a number", "int": "a whole number", "str": "a text", "bool": "true or false", "array": "a list",
    "object": "a section",
}  # fmt: skip
_BOUNDS: Final = {">=": "of at least", ">": "above", "<=": "of at most", "<": "below"}
_EXPECTED: Final = re.compile(
    r"Expected `(?P<kinds>[\w |]+)`(?: (?P<sign>[<>]=?) (?P<bound>\S+?))?(?: of length (?P<length>.+?))?(?:, got .*)?"
)


@dataclass(frozen=True)
class TomlSource:
    """A file, preset or option that holds TOML, and how messages name what is in it."""

    name: str  # start of every message
    hint: str = _HINT  # for a wrong value
    content: dict[str, Any] = field(default_factory=dict)
    assigned: str = "{} = {}"  # format of an assignment, with ``{}`` for key and value
    text: str = ""  # of a file

    def has(self, *keys: str | int) -> bool:
        """Return whether it contains a key, given by its path from the top."""
        inner: Any = self.content
        for key in keys:
            inner = inner.get(key) if isinstance(inner, Mapping) else None
        return inner is not None


# --- Reading and converting


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML.

    Raises
    ------
    tomllib.TOMLDecodeError
        The text is not TOML, or has too many digits or brackets for Python.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise tomllib.TOMLDecodeError("Too many nested brackets") from error
    except ValueError as error:
        raise tomllib.TOMLDecodeError("A number has too many digits") from error


def read_toml(
    path: Path,
    hint: str,
    *,
    if_unreadable: str,
    if_invalid: str,
) -> TomlSource:
    """Read a user's file.

    Parameters
    ----------
    path : Path
        The file.
    hint : str
        For wrong values in it, which others find.
    if_unreadable, if_invalid : str
        Hints for a file that cannot be read, and for one that is not TOML.

    Raises
    ------
    ConfigError
        The file cannot be read, is a log, or is not TOML in UTF-8.
    """
    try:
        text = read_text(path)
        return TomlSource(str(path), hint, parse_toml(text), text=text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}", if_unreadable) from error
    except UnicodeDecodeError as error:
        if looks_like_log(path):
            hint = f"a log needs no option: `insdvl-replay run {path}`"
            raise ConfigError(f"{path}: is a log, where a TOML file is expected", hint) from error
        raise ConfigError(
            f"{path}: is not UTF-8 text (byte {error.start})", "use a TOML file"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not valid TOML: {error}", if_invalid) from error


def converted(table: object, kind: type[S], source: TomlSource, *at: str, label: str = "") -> S:
    """Convert a table to its structure.

    Parameters
    ----------
    table : object
        The table as TOML has it.
    kind : type
        Its structure.
    source : TomlSource
        Where it is from.
    *at : str
        Its path from the top, which names it in errors.
    label : str
        Names it instead of the path.

    Raises
    ------
    ConfigError
        A key is unknown or missing, or a value is wrong. It names the key, the value and what was expected.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        with error_context(f"{source.name}: {label}" if label else source.name):
            raise _explained(error, table, kind, source, () if label else at) from error


def _explained(
    error: msgspec.ValidationError,
    table: Any,
    kind: type[Struct],
    source: TomlSource,
    at: KeyPath,
) -> ConfigError:
    """Return the error for a wrong key or value in a table."""
    reason, keys = _reason_and_keys(str(error))
    value, wanted = _value_at(table, kind, keys)
    name = dotted(*at, *keys)
    unknown = re.fullmatch(r"Object contains unknown field `(.*)`", reason, re.DOTALL)
    if unknown is not None:
        structure = _structure(wanted)
        known = () if structure is None else structure.__struct_fields__
        elsewhere = [f"{dotted(*at)}.{path}" for path in _known_paths(kind)]
        return _unknown_key(unknown[1], known, name, elsewhere, source)
    if isinstance(value, str):
        words = tuple(_words(wanted))
        if words and value not in words:
            return ConfigError(f"{name} '{value}' is not known", hint_for(value, words))
    shown = _shortened(repr(value))
    is_section = reason.startswith("Expected `object`")
    if is_section and name and not name.endswith("]"):
        return ConfigError(f"{name} is a section, found {shown}", f"write [{name}]")
    what = value_wanted(reason)
    if name:
        what = f"{name}: {what}"
    if keys:
        what += f", found {shown}"
    hint = source.hint
    if reason.startswith("Expected `array`"):
        example = _list_meant(value, wanted)
        if example:
            hint = f"write a list: {source.assigned.format(name, example)}"
    return ConfigError(what, hint)


def _reason_and_keys(message: str) -> tuple[str, KeyPath]:
    """Take a message of msgspec apart: what is wrong, and the path to the value."""
    found = re.fullmatch(r"(.*?)(?: - at `\$\.?([^`]*)`)?", message, re.DOTALL)
    if found is None:
        return message, ()
    reason, place = found.groups("")
    keys = (int(part) if part.isdigit() else part for part in re.findall(r"\w+", place))
    return reason, tuple(keys)


def _value_at(table: Any, kind: Any, keys: KeyPath) -> tuple[Any, Any]:
    """Return a value of a table by its path, and the type that it should have."""
    for key in keys:
        table = table[key]
        structure = _structure(kind)
        if isinstance(key, str) and structure is not None:
            kind = get_type_hints(structure)[key]
    return table, kind


def _shortened(text: str) -> str:
    if len(text) <= _LONGEST_SHOWN:
        return text
    return f"{text[:_LONGEST_SHOWN]}..."


def _unknown_key(
    key: str,
    known: Sequence[str],
    within: str,
    elsewhere: Sequence[str],
    source: TomlSource,
) -> ConfigError:
    """Return the error for an unknown key, with similar known keys, here or in other tables."""
    inside = f"{within}.".removeprefix(".")
    meant = [inside + name for name in _keys_meant(key, known)]
    if not meant:
        meant = _keys_elsewhere(key, [path.removeprefix(".") for path in elsewhere])
    hint = f"known: {listed(known)}"
    if len(known) > LISTED:
        hint += f"; {source.hint}"
    if meant:
        *first, last = meant
        either = f"{', '.join(first)} or {last}" if first else last
        hint = f"did you mean {either}?"
    return ConfigError(f"key '{inside}{key}' is not known", hint)


def _keys_meant(key: str, known: Sequence[str]) -> list[str]:
    """Return the known keys of a table that an unknown one may stand for."""
    similar = most_like(key, known, most=1, least=_MISSPELLED) or _with_words(key, known, 1)
    near = nearest(key, known)
    if not similar and near:
        return [near]
    return similar


def _keys_elsewhere(key: str, paths: Sequence[str]) -> list[str]:
    """Return the keys of other tables that an unknown one may stand for, by their paths."""
    same = [path for path in paths if path.rpartition(".")[2] == key]
    return same[:3] or _with_words(key, paths, 2)


def value_wanted(reason: str) -> str:
    """Return msgspec's reason, such as ``Expected `array` of length 3, got 2``, without type names."""
    if lacking := re.fullmatch(r"Object missing required field `(\w+)`", reason):
        return f"needs the key {lacking[1]}"
    found = _EXPECTED.fullmatch(reason)
    if found is None:
        return reason[:1].lower() + reason[1:]
    names = [kind.strip() for kind in found["kinds"].split("|")]
    kinds = [_KINDS.get(name, name) for name in names if name != "null"]
    if "a number" in kinds and "a whole number" in kinds:
        kinds.remove("a whole number")
    needs = f"needs {' or '.join(kinds)}"
    if found["sign"]:
        needs += f" {_BOUNDS[found['sign']]} {float(found['bound']):g}"
    if found["length"]:
        needs += f" of {found['length']} values"
    return needs


def _list_meant(value: object, kind: Any) -> str:
    """Return as TOML the list that a wrong value such as ``"[depth, position]"`` meant; empty if unclear."""
    parts: list[Any] = [value]
    if isinstance(value, str):
        parts = [part.strip() for part in value.strip(" []").split(",")]
    with suppress(ValueError):
        parts = [float(part) if isinstance(part, str) else part for part in parts]
    for entries in (parts, [0.0, 0.0, 0.0]):
        with suppress(msgspec.ValidationError):
            msgspec.convert(entries, kind)
            return toml_value(entries)
    return ""


def _structure(hint: object) -> type[Struct] | None:
    """Return the structure that a field holds, if it is one."""
    if get_origin(hint) in (dict, tuple):
        return None
    for kind in (hint, *get_args(hint)):
        if isinstance(kind, type) and issubclass(kind, Struct):
            return kind
    return None


def _known_paths(kind: type[Struct], above: str = "") -> Iterator[str]:
    """Yield the dotted path of every key of a structure and of those inside it."""
    for name, hint in get_type_hints(kind).items():
        if (inner := _structure(hint)) is not None:
            yield from _known_paths(inner, f"{above}{name}.")
        elif name in kind.__struct_fields__:
            yield above + name


def _words(hint: object) -> Iterator[str]:
    """Yield the allowed words of a value."""
    if isinstance(hint, EnumMeta):
        yield from hint.__members__.values()
    for inner in get_args(hint):
        if get_origin(hint) is Literal:
            yield inner
        else:
            yield from _words(inner)


def _with_words(name: str, known: Collection[str], least: int) -> list[str]:
    """Return the names that share the most words with a name. Units do not count; some words have synonyms."""

    def words_of(text: str) -> set[str]:
        return {word for word in re.split(r"[_.]", text.lower()) if word and word not in _UNITS}

    wanted: set[str] = set()
    for part in words_of(name):
        wanted.update((part, *_ALSO_CALLED.get(part, "").split()))
    shared = {other: len(wanted & words_of(other)) for other in known}
    most = max(shared.values(), default=0)
    similar = [other for other, count in shared.items() if count == most]
    if most >= least:
        return most_like(name, similar, most=3)
    return []


# --- Layers


def load_config(
    preset: str | None = None,
    file: Path | Sequence[Path] | None = None,
    overrides: Sequence[str] = (),
    *,
    against: Sequence[str] = (),
    allow_code: bool = False,
    unnamed: Path | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> Config:
    """Resolve the settings: defaults < preset < file < overrides < against.

    Parameters
    ----------
    preset : str, optional
        One of `PRESETS`. Without it, files change the defaults.
    file : Path or sequence of Path, optional
        TOML files; later ones override earlier ones, key by key. The filters of the first file that has some replace
        those of the preset. The filters of later files are added; one with a known name replaces that filter.
    overrides, against : sequence of str
        ``section.key=value`` with a TOML value; a bare word is taken as a string. ``filters.NAME=false`` leaves a
        filter out.
    allow_code : bool
        The settings may name code, as ``module:Class``. Nothing is imported here.
    unnamed : Path, optional
        The one of the files that nobody has named. Code in it is never allowed.
    report : callable
        Is called with a sentence for each filter that a file replaces.

    Raises
    ------
    ConfigError
        Unknown preset, unreadable file, unknown key (with the nearest known one), value of the wrong kind or range,
        code that is not allowed.
    """
    layers = _preset_and_files(preset, [file] if isinstance(file, Path) else file or (), unnamed)
    changes = [
        *(_parse_override("--set", override) for override in overrides),
        *(_parse_override("--against", override) for override in against),
    ]
    settings = msgspec.to_builtins(Config())
    if preset is None and not any(layer.has("noise") for layer in (*layers, *changes)):
        # The aiding of the paper's filters has a noise of its own. Those of the classes of IMUs take it from the fit.
        settings["filters"] = msgspec.to_builtins(load_config(FITTED_LIKE).filters)
    owners = dict[str, str]()  # by filter, the file that names it
    for layer in layers:
        settings = _overridden(_with_place_for(layer, settings, owners, report), layer)
        _resolved(settings, layer)
    config = _changed(settings, changes)
    if unnamed is not None:
        _require_no_code_in(str(unnamed), config, [*layers, *changes])
    _require_possible(config, [*layers, *changes], allow_code=allow_code)
    if not any(layer.has("noise", "fit") for layer in (*layers, *changes)):
        noise = msgspec.structs.replace(
            config.noise, fit=_free_noise(config, preset, [*layers, *changes])
        )
        config = msgspec.structs.replace(config, noise=noise)
    return _with_digests(config)


def _preset_and_files(
    preset: str | None, files: Sequence[Path], unnamed: Path | None
) -> list[TomlSource]:
    """Read the layers below single settings."""
    if preset is not None and preset not in PRESETS:
        raise ConfigError(f"preset '{preset}' is not known", f"use one of: {', '.join(PRESETS)}")
    layers = [] if preset is None else [_preset(preset)]
    for path in files:
        source = _file(path, is_named=path != unnamed)
        layers.append(replace(source, content=_with_whole_paths(source.content, path.parent)))
    return layers


def changed_by(config: Config, against: Sequence[str], *, allow_code: bool = False) -> Config:
    """Change settings whose noise is fitted already, as ``--against`` says.

    A noise of the velocity that is given replaces a fitted noise of the beams, which would override it.

    Parameters
    ----------
    config : Config
        Resolved settings, which stay as they are.
    against : sequence of str
        ``section.key=value``, as for `load_config`.
    allow_code : bool
        The changes may name code.

    Raises
    ------
    ConfigError
        A change is not of this form, its key is unknown, its value is wrong, or it names code that is not allowed.
    """
    changes = [_parse_override("--against", override) for override in against]
    given = [change.has("dvl", "beam_sd_mps") for change in changes]
    if any(change.has("dvl", "velocity_sd_mps") for change in changes) and not any(given):
        changes.insert(0, _parse_override("--against", "dvl.beam_sd_mps=none"))
    changed = _changed(msgspec.to_builtins(config), changes)
    _require_possible(changed, changes, allow_code=allow_code)
    return _with_digests(changed)


def _free_noise(
    config: Config, preset: str | None, layers: Sequence[TomlSource]
) -> tuple[Any, ...]:
    """Name what is fitted to the dives: what nobody has given, and nothing where the noise of the IMU is given."""
    baseline = config.filters[config.baseline]
    own = {
        "imu": None not in (baseline.accel_white_mps_rts, baseline.gyro_white_rad_rts),
        "dvl": (baseline.velocity_sd_mps, baseline.beam_sd_mps) != (None, None),
    }
    free = []
    for word, keys in FREE.items():
        paths = [key.split(".") for key in keys]
        is_given = any(_gives(layer, paths) for layer in layers)
        if not is_given and not own.get(word, False):
            free.append(word)
    if preset is None and "imu" in free:
        return tuple(free)
    return ()


def _gives(layer: TomlSource, paths: Sequence[Sequence[str]]) -> bool:
    return any(layer.has(*path) for path in paths)


def _changed(settings: Any, changes: Sequence[TomlSource]) -> Config:
    """Apply changes together, since a valid filter may need two of them."""
    try:
        whole = reduce(_overridden, changes, settings)
        return _resolved(whole, TomlSource("the configuration"))
    except ConfigError:
        for change in changes:  # finds the wrong one
            settings = _overridden(settings, change)
            _resolved(settings, change)
        raise


def _require_possible(config: Config, layers: Sequence[TomlSource], *, allow_code: bool) -> None:
    """Raise the first problem of settings; it names the last layer with the wrong key."""
    for key, what, hint in problems(config, allow_code=allow_code):
        if not key:
            raise ConfigError(what, hint)
        places = [layer.name for layer in layers if layer.has(*key)]
        raise ConfigError(what, hint, places[-1] if places else "the configuration")


def _require_no_code_in(file: str, config: Config, layers: Sequence[TomlSource]) -> None:
    """Raise a ConfigError if the settings name code that they have from a file which nobody has named."""
    for key, what, _ in code_problems(config):
        places = [layer.name for layer in layers if layer.has(*key)]
        if places[-1:] == [file]:
            hint = f"read it; to run it, name the file: -c {shlex.quote(file)} --allow-code"
            raise ConfigError(f"{what}, which does not run unless -c names the file", hint, file)


def given_keys(
    preset: str | None, files: Sequence[Path], overrides: Sequence[str]
) -> frozenset[str]:
    """Name the keys that are given, also those with the value of the default.

    A preset gives the keys that any preset sets.

    Parameters
    ----------
    preset, files, overrides
        As for `load_config`.

    Raises
    ------
    ConfigError
        A file cannot be read, is not TOML or holds no settings, or an override is not ``section.key=value``.
    """
    given = [*map(_file, files), *(_parse_override("--set", override) for override in overrides)]
    if preset:
        given += map(_preset, PRESETS)
    keys = set[str]()
    for source in given:
        keys.update(key for key, value in flattened(source.content) if value is not None)
    return frozenset(keys)


def _preset(name: str) -> TomlSource:
    text = resources.files("insdvl_replay").joinpath("presets", f"{name}.toml").read_text("utf-8")
    return TomlSource(f"preset {name}", content=parse_toml(text))


def _file(path: Path, *, is_named: bool = True) -> TomlSource:
    """Read a file of settings; one that nobody has named may be anything, and is not waited for."""
    hints = {"if_unreadable": _IF_UNREADABLE, "if_invalid": _IF_INVALID}
    if not is_named:
        hints = {"if_unreadable": _IF_UNNAMED, "if_invalid": _IF_UNNAMED}
        with suppress(OSError):  # which reading it raises
            if not stat.S_ISREG(path.stat().st_mode):
                raise ConfigError(f"{path}: is no regular file", _IF_UNNAMED)
    source = read_toml(path, _HINT, **hints)
    require_kind_of_toml(path, source.content, "settings", SECTIONS)
    converted(source.content.get(FOUND, {}), Found, source, FOUND)
    settings = {name: table for name, table in source.content.items() if name != FOUND}
    return replace(source, content=settings)


def given_keys_in(path: Path) -> tuple[str, ...]:
    """Name the keys that were given as the settings of a file were found.

    Raises
    ------
    ConfigError
        Unreadable file, or a wrong key or value in its table ``found``.
    """
    source = read_toml(path, _HINT, if_unreadable=_IF_UNREADABLE, if_invalid=_IF_INVALID)
    return converted(source.content.get(FOUND, {}), Found, source, FOUND).given


def _with_place_for(
    layer: TomlSource,
    settings: dict[str, Any],
    owners: dict[str, str],
    report: Callable[[str], None],
) -> dict[str, Any]:
    """Empty the filters that a layer defines anew: of the first file all that were there, of later ones their own."""
    given = layer.content.get("filters")
    filters = settings["filters"]
    if not isinstance(given, Mapping):
        return settings
    defined = [name for name, entry in given.items() if entry is not False]
    if not owners and (defined or not given):
        filters = {}
    for name in defined:
        if name in filters and filters[name] != given[name]:
            report(f"{layer.name} replaces the filter {name} of {owners[name]}")
    if layer.text:  # a file, not a preset
        owners.update(dict.fromkeys(defined, layer.name))
    return settings | {
        "filters": {name: {} if name in defined else entry for name, entry in filters.items()}
    }


def _overridden(settings: Mapping[str, Any], source: TomlSource) -> dict[str, Any]:
    """Put a source over the settings. A filter that it sets to ``false`` is left out."""
    merged = _merged(settings, source.content)
    if isinstance(filters := merged["filters"], Mapping):
        for name in (name for name, entry in filters.items() if entry is False):
            with error_context(source.name):
                require_known("filter", name, settings["filters"])
        merged["filters"] = {name: entry for name, entry in filters.items() if entry is not False}
    return merged


def _parse_override(option: str, text: str) -> TomlSource:
    path, equals, value = text.partition("=")
    keys = path.strip().split(".")
    example = f"for example {option} dvl.scale=1.01"
    if not equals or not all(keys) or len(keys) < 2:
        raise ConfigError(f"{option} {text}: is not of the form section.key=value", example)
    if not is_writable(text):
        raise ConfigError(f"{option} {text}: is not UTF-8 text", example)
    try:
        parsed: Any = parse_toml(f"value = {value.strip()}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    if parsed == "none" and keys[-1] != "align":  # as results write a setting that is left out
        parsed = None
    for key in reversed(keys):
        parsed = {key: parsed}
    return TomlSource(f"{option} {text}", content=parsed, assigned=f"{option} '{{}}={{}}'")


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        if key == "solution" and isinstance(old, str):
            old = {key_of(old): old}
        merged[key] = (
            _merged(old, value)
            if isinstance(old, Mapping) and isinstance(value, Mapping)
            else value
        )
    return merged


def _resolved(settings: Mapping[str, Any], source: TomlSource) -> Config:
    """Check kinds and ranges. Filters and topics are converted one by one, so that a message can name its own."""
    for section, kind in (("filters", Filter), ("topics", Topic)):
        if isinstance(entries := settings.get(section), Mapping):
            of_each = {
                name: converted(entry, kind, source, section, name)
                for name, entry in entries.items()
            }
            settings = {**settings, section: of_each}
    config = converted(settings, Config, source)
    for path, number in _numbers(msgspec.to_builtins(config)):
        if not math.isfinite(number):
            what = f"must be a finite number, found {number}"
            hint = "leave the key out if there is no limit"
        elif abs(number) > LARGEST:
            what = f"must be at most {LARGEST:.0e}, found {number}"
            hint = "`insdvl-replay config` prints its unit"
        else:
            continue
        raise ConfigError(f"{source.name}: {dotted(*path)} {what}", hint)
    return config


def _numbers(value: object, *path: Any) -> Iterator[tuple[KeyPath, float]]:
    if isinstance(value, float | int):
        yield path, value
    elif isinstance(value, Mapping | list | tuple):
        for key, inner in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from _numbers(inner, *path, key)


def _with_whole_paths(content: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Make the paths of solution files absolute, in place."""
    filters = content.get("filters")
    if not isinstance(filters, Mapping):
        return content
    for entry in filters.values():
        if isinstance(entry, dict):
            _make_paths_whole(entry, folder)
    return content


def _make_paths_whole(entry: dict[str, Any], folder: Path) -> None:
    """Make the paths of one filter's solution and program absolute, in place."""
    program = entry.get("program")
    solution = entry.get("solution")
    if isinstance(program, list):
        entry["program"] = [_whole_path(word, folder) for word in program]
    if isinstance(solution, str) and key_of(solution) == "file":
        entry["solution"] = str((folder / solution).absolute())
    elif isinstance(solution, dict) and isinstance(solution.get("file"), str):
        solution["file"] = str((folder / solution["file"]).absolute())


def _whole_path(word: Any, folder: Path) -> Any:
    """Make an argument absolute that begins with ``./`` or ``../``."""
    if isinstance(word, str) and word.startswith(("./", "../")):
        return str((folder / word).absolute())
    return word


def _with_digests(config: Config) -> Config:
    """Add the SHA-256 of solution files, so that another file means other settings; make programs' paths absolute."""
    filters = dict(config.filters)
    for name, filter_ in config.user_candidates.items():
        if filter_.program is not None:
            program = tuple(_whole_path(word, Path()) for word in filter_.program)
            filters[name] = msgspec.structs.replace(filter_, program=program)
    for name, solution in config.solutions.items():
        if solution.file is None:
            continue
        key = f"filters.{name}.solution"
        try:
            sha256 = hashlib.sha256(read_regular(Path(solution.file), MOST_BYTES)).hexdigest()
        except OSError as error:
            raise ConfigError(
                f"{key}: {solution.file}: cannot be read: {error.strerror}",
                "paths are relative to the folder of the settings file",
            ) from error
        if solution.sha256 not in (None, sha256):
            raise ConfigError(
                f"{key}: {solution.file} is not the expected file: its SHA-256 is {sha256}",
                f"leave {key}.sha256 out to accept it",
            )
        whole = msgspec.structs.replace(
            solution, file=str(Path(solution.file).absolute()), sha256=sha256
        )
        filters[name] = msgspec.structs.replace(filters[name], solution=whole)
    return msgspec.structs.replace(config, filters=filters)


# --- Writing


_AS_BY_DEFAULT: Final = msgspec.structs.asdict(Config())


def render_toml(config: Config, *, changed_only: bool = False) -> str:
    """Write the settings as commented TOML; reading it back gives the same. Keys that are left out are comments.

    Parameters
    ----------
    config : Config
        The settings.
    changed_only : bool
        Write only what is not as by default. Of filters and topics, all are written if one is not.
    """
    return "\n".join(_toml_lines(config, "", changed_only=changed_only)).strip() + "\n"


def _toml_lines(section: Struct, path: str, *, changed_only: bool) -> Iterator[str]:
    hints = get_type_hints(type(section), include_extras=True)
    default = _defaults_of(section, path)
    tables: list[tuple[str, Struct]] = []
    for name in _written_keys(section):
        value = getattr(section, name)
        if changed_only and value == default[name]:
            continue
        if isinstance(value, Struct):
            tables.append((f"{path}{name}", value))
        elif isinstance(value, dict):
            tables += [(f"{path}{name}.{key}", entry) for key, entry in value.items()]
        elif get_origin(hints[name]) is Annotated:
            text = f"# {name} =" if value is None else f"{name} = {toml_value(value)}"
            yield f"{text:<40}  # {hints[name].__metadata__[-1].description}"
    for table_path, table in tables:
        yield f"\n[{table_path}]"
        yield from _toml_lines(table, f"{table_path}.", changed_only=changed_only)


def _defaults_of(section: Struct, path: str) -> dict[str, Any]:
    """Return what is left out where only changes are written: of the whole, of a section that is always there, else
    of its kind.
    """
    if not path:
        return _AS_BY_DEFAULT
    usual = _AS_BY_DEFAULT.get(path.rstrip("."))
    if isinstance(usual, Struct):
        return msgspec.structs.asdict(usual)
    return {field.name: field.default for field in msgspec.structs.fields(section)}


def _written_keys(section: Struct) -> Sequence[str]:
    """Return the keys of a section; of an onboard solution, a program or a class only its own."""
    names = section.__struct_fields__
    if not isinstance(section, Filter):
        return names
    own = candidate_keys(section)
    if own:
        return own
    return [name for name in names if name not in ("program", "timeout_s", "input", "candidate")]


def toml_value(value: object) -> str:
    """Write a number, a text, a truth value, or a list or table of these as TOML."""
    if isinstance(value, bool):
        if value:
            return "true"
        return "false"
    if isinstance(value, str):
        # A JSON string is valid TOML, except for the one control character that JSON does not escape.
        return visible(msgspec.json.encode(value).decode().replace("\x7f", "\\u007f"))
    if isinstance(value, tuple | list):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {toml_value(item)}' for key, item in value.items())} }}"
    return repr(value)


def check_start(
    initial: Initial,
    *,
    has_reference: bool,
    has_position: bool,
    has_attitude: bool,
    has_heading: bool = False,
) -> None:
    """Require that settings, reference and sensors determine the start of a filter.

    Parameters
    ----------
    initial : Initial
        The settings of the start.
    has_reference, has_position, has_attitude : bool
        Whether there is a reference, and whether it has positions and attitudes.
    has_heading : bool
        Whether a sensor gives the heading.

    Raises
    ------
    LogError
        The start is that of the reference, and there is none.
    ConfigError
        Nothing gives the latitude, or nothing gives the heading.
    """
    from_reference = initial.source == "reference"
    if from_reference and not has_reference:
        raise LogError(
            "no reference solution was found to start from",
            "set reference.topic=... and its fields (a solution under [filters] is no reference); or start level: "
            "--set initial.source=level --set initial.heading_deg=... --set initial.latitude_deg=...; or start from "
            "an AHRS in the log: --set initial.source=sensor --set initial.latitude_deg=...",
        )
    if not has_position:
        start_latitude_deg(initial)
    if not (has_heading or (from_reference and has_attitude)) and initial.heading_deg is None:
        by_track = ', or "fit", from the track of its positions' if has_position else ""
        raise ConfigError(
            'the heading at the start is needed: the reference has none, or initial.source = "level" ignores it',
            f'--set initial.heading_deg=... (or "sensor", from an AHRS or a compass{by_track})',
        )


def start_latitude_deg(initial: Initial) -> float:
    """Return the latitude of the settings in degrees, for a dive whose reference has no position.

    Raises
    ------
    ConfigError
        The settings have none.
    """
    if initial.latitude_deg is None:
        raise ConfigError(
            "the latitude is needed for gravity and Earth rate, and there is no reference with a position",
            "--set initial.latitude_deg=...",
        )
    return initial.latitude_deg
