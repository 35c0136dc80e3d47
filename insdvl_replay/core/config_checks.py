"""Checks across the keys of settings: unknown words, invalid names, filters that contradict themselves."""

import re
from collections.abc import Collection, Iterator, Sequence
from typing import Final

from insdvl_replay.core.config import TOPIC_KEYS, Config, Filter, spelled_out
from insdvl_replay.core.config_limits import impossible_values
from insdvl_replay.core.errors import hint_for, nearest
from insdvl_replay.core.held_out import HeldOut
from insdvl_replay.core.quantities import DECIDERS
from insdvl_replay.core.states import AIDING, DVL_AIDING, MORE_STATES, SENSORS

KeyPath = tuple[str | int, ...]
"""Names of tables and keys from the top, and places in arrays among them."""
Problem = tuple[KeyPath, str, str]
"""Key, whose layer the message names; what is wrong; and a hint."""
Remark = tuple[str, str]
"""What is wrong with a filter, and a hint."""

# The keys of filters that are not the tool's own, by kind.
_CANDIDATE_KEYS: Final = {
    "solution": ("solution",),
    "program": ("program", "timeout_s", "input", "version"),
    "candidate": ("candidate", "timeout_s", "version"),
}
# States that need one of these measurements among the aiding or the held-out sensors.
_MEASURED_BY: Final = {
    "dvl_scale": DVL_AIDING,
    "dvl_yaw": DVL_AIDING,
    "depth_zero": ("depth",),
    "heading_bias": ("heading",),
}
_PROGRAM: Final = 'program = ["./my_filter", "{dive}", "{start}", "{solution}"]'
# What a program may read a dive from: the one as MCAP, or the other as CSV.
_INPUTS: Final = ("{dive}", "{imu_csv}")


def problems(config: Config, *, allow_code: bool) -> Iterator[Problem]:
    """Yield unknown words, invalid names, inconsistent filters, and code that is not allowed."""
    yield from impossible_values(config)
    yield from _evaluation_problems(config)
    if not config.filters:
        hint = 'add [filters.baseline] with aiding = ["velocity"]'
        yield ("filters",), "no filter is configured", hint
    for name in config.topics:
        if not _is_name(name):
            what = f"topic name '{name}' must be a letter followed by letters, digits and _"
            yield (), what, '[topics.range] topic = "/range", values = "range"'
    for name, filter_ in config.filters.items():
        yield from _filter_problems(name, filter_, config)
    if not allow_code:
        yield from code_problems(config)


def code_problems(config: Config) -> Iterator[Problem]:
    """Yield each place where filters name code of the user."""
    for name, filter_ in config.filters.items():
        yield from _code_problems(name, filter_)


def dotted(*keys: str | int) -> str:
    """Write the path of a key as in TOML, with places in arrays in brackets."""
    text = ""
    for key in keys:
        text += f"[{key}]" if isinstance(key, int) else f".{key}"
    return text.removeprefix(".")


def candidate_keys(filter_: Filter) -> tuple[str, ...]:
    """Return the keys of an onboard solution, a program or a class; none for the tool's own filters."""
    for kind, keys in _CANDIDATE_KEYS.items():
        if getattr(filter_, kind) is not None:
            return keys
    return ()


def _evaluation_problems(config: Config) -> Iterator[Problem]:
    evaluation = config.evaluation
    yield from _wrong_words(evaluation.held_out, SENSORS, "evaluation", "held_out")
    primary = evaluation.primary
    if primary and primary not in DECIDERS:
        what = f"evaluation.primary '{primary}' is not known"
        yield ("evaluation", "primary"), what, hint_for(primary, DECIDERS)
    candidate = evaluation.candidate
    candidates = [name for name in config.filters if name != config.baseline]
    if candidate and candidate not in candidates:
        what = f"evaluation.candidate '{candidate}' is no candidate"
        yield ("evaluation", "candidate"), what, hint_for(candidate, candidates)


def _filter_problems(name: str, filter_: Filter, config: Config) -> Iterator[Problem]:
    path = ("filters", name)
    key = dotted(*path)
    if not _is_name(name):
        what = f"filter name '{name}' must be a letter followed by letters, digits and _"
        yield path, what, "it is used in topics and tables"
    classes = [word for word in filter_.aiding if ":" in word]
    known = (*AIDING, "module:Class", *classes)
    yield from _wrong_words(filter_.aiding, known, *path, "aiding")
    yield from _wrong_words(filter_.states, MORE_STATES, *path, "states")
    if candidate_keys(filter_):
        remarks = _candidate_remarks(filter_, key, is_baseline=name == config.baseline)
    else:
        remarks = _filter_remarks(filter_, config, name)
    for what, hint in remarks:
        yield path, what, hint


def _code_problems(name: str, filter_: Filter) -> Iterator[Problem]:
    """Yield each place where a filter names code of the user."""
    for place, word in enumerate(filter_.aiding):
        if ":" in word:
            yield _names_code(word, name, "aiding", place)
    for key in ("noise_factors", "candidate"):
        word = getattr(filter_, key)
        if word is not None:
            yield _names_code(word, name, key)
    if filter_.program is not None:
        yield _names_code(" ".join(filter_.program), name, "program")


def _names_code(code: str, name: str, key: str, *place: int) -> Problem:
    hint = "add --allow-code to `run`, `check` or `calibrate`; the code runs with your permissions"
    what = f"{dotted('filters', name, key, *place)} names code: {code}"
    return ("filters", name, key), what, hint


def _wrong_words(words: Sequence[str], known: Collection[str], *path: str) -> Iterator[Problem]:
    for place, word in enumerate(words):
        key = dotted(*path, place)
        if word not in known:
            yield path, f"{key} '{word}' is not known", hint_for(word, known)
        if word in words[:place]:
            yield path, f"{key} '{word}' is given twice", "leave one of them out"


def _is_name(name: str) -> bool:
    return name.isascii() and name.isidentifier()


def _is_class(word: str | None) -> bool:
    return re.fullmatch(r"[^:]+:[^:]+", word or "") is not None


# --- One filter


def _candidate_remarks(filter_: Filter, key: str, *, is_baseline: bool) -> Iterator[Remark]:
    """Check that a solution, a program or a class is not the baseline, and has no keys of the tool's own filters."""
    own = candidate_keys(filter_)
    kind = own[0]
    what = "your code"
    not_run = ""
    why = "the tool judges it against one of its own filters"
    if kind == "solution":
        what = "read"
        not_run = " and not run"
        why = "all filters begin from the baseline's start"
    if is_baseline:
        yield (
            f"{key}.{kind} is {what} and cannot be the baseline: {why}",
            'put a filter with aiding first, such as [filters.baseline] with aiding = ["velocity"]',
        )
    default = Filter()
    useless = []
    for name in Filter.__struct_fields__:
        if name not in own and getattr(filter_, name) != getattr(default, name):
            useless.append(f"{key}.{name}")
    if useless:
        names = " and ".join(useless)
        yield f"{key}.{kind} is {what}{not_run}, so {names} has no use", "leave one of them out"
    if kind == "solution":
        yield from _solution_remarks(filter_, key)
    elif kind == "program":
        yield from _program_remarks(filter_, key)
    elif not _is_class(filter_.candidate):
        yield (
            f"{key}.candidate '{filter_.candidate}' is not of the form module:Class",
            'candidate = "my_package.module:MyFilter"',
        )


def _solution_remarks(filter_: Filter, key: str) -> Iterator[Remark]:
    solution = spelled_out(filter_.solution or "")
    example = 'solution = "/odometry", or solution = "onboard.tum"'
    if solution.topic is None and solution.file is None:
        yield f"{key}.solution names no topic and no file", example
    if solution.topic is not None and solution.file is not None:
        yield f"{key}.solution names a topic and a file", example
    if solution.file is None:
        return
    for name in ("fix", *TOPIC_KEYS):
        if getattr(solution, name) is not None:
            yield (
                f"{key}.solution is a file, and {key}.solution.{name} is for topics only",
                "leave it out. Each line has time x y z qx qy qz qw; solution.axes names the axes",
            )


def _program_remarks(filter_: Filter, key: str) -> Iterator[Remark]:
    program = filter_.program
    if not program:
        yield f"{key}.program is empty", _PROGRAM
        return
    arguments = " ".join(program)
    lacking = []
    if not any(word in arguments for word in _INPUTS):
        lacking.append(" or ".join(_INPUTS))
    if "{solution}" not in arguments:
        lacking.append("{solution}")
    if lacking:
        yield f"{key}.program has no argument with {' and '.join(lacking)}", _PROGRAM
    if filter_.input is not None and "{dive}" not in arguments:
        yield f"{key}.input has no use without {{dive}}, since CSV has clean readings", _PROGRAM


def _hint_without_aiding(name: str, config: Config) -> str:
    """Return what to do about a filter without aiding: its name may be meant to be that of another."""
    others = [other for other, filter_ in config.filters.items() if filter_.aiding]
    meant = nearest(name, others)
    if meant:
        return f'did you mean filters.{meant}? A new filter needs aiding = ["velocity"]'
    return 'aiding = ["velocity"]'


def _filter_remarks(filter_: Filter, config: Config, name: str) -> Iterator[Remark]:
    """Check that the aiding, the states and the other keys of one of the tool's own filters belong together."""
    key = dotted("filters", name)
    held_out = config.held_out
    aiding = set(filter_.aiding)
    if not aiding:
        yield f"{key}.aiding is empty", _hint_without_aiding(name, config)
    if filter_.noise_factors is not None and not _is_class(filter_.noise_factors):
        yield (
            f"{key}.noise_factors '{filter_.noise_factors}' is not of the form module:Class",
            'noise_factors = "my_package.module:MyNoise"',
        )
    for name in ("version", "input", "timeout_s"):
        if getattr(filter_, name) is not None and not filter_.code:
            yield f"{key}.{name} has no use without code of yours", "leave it out"
    if aiding >= {"velocity", "beams"}:
        yield f"{key} uses every ping twice, as velocity and as beams", 'aiding = ["beams"]'
    if "acceleration" in aiding and filter_.acceleration is None:
        yield (
            f"{key} is aided by acceleration but has no acceleration settings",
            f'[{key}] acceleration = {{ model = "windowed", window = 3 }}',
        )
    yield from _unmeasured_states(filter_, held_out, key)
    if filter_.acceleration is not None:
        order = filter_.acceleration.order
        window = filter_.acceleration.window
        if order >= window:
            yield (
                f"{key}.acceleration.order = {order} needs a window above {order}, found {window}",
                f"window = {order + 1}",
            )


def _unmeasured_states(filter_: Filter, held_out: HeldOut, key: str) -> Iterator[Remark]:
    for state, measured_by in _MEASURED_BY.items():
        if state not in filter_.states:
            continue
        if held_out.met(filter_.aiding).isdisjoint(measured_by):
            yield (
                f"{key} estimates {state}, but none of its sensors measures it",
                f"add {' or '.join(measured_by)} to {key}.aiding, or remove {state} from {key}.states",
            )
