"""What a docstring of `api` and `core` has to say: a shape and a unit for arrays, errors, and the parameters of `api`.

Names are looked up as they are written, so that an error that comes from another room or a method is not seen.
"""

import ast
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "insdvl_replay"
MODULES = [PACKAGE / "api.py", *sorted((PACKAGE / "core").glob("*.py"))]
ARRAYS = re.compile(r"\b(?:Floats|Integers|TimeNs|Mask|Array|NDArray)\b")
NUMBERS = re.compile(r"\b(?:Floats|TimeNs)\b")
SHAPE = re.compile(r"\([a-z0-9]+(?:, ?[a-z0-9]+)*,?\)|\(k, \.\.\.\)|\bany shape\b|\bof a shape\b")
UNIT = re.compile(r"\b(?:ns|nanoseconds?|s|seconds?|m|m/s|m/s\^2|rad|deg|SI|any unit|no unit)\b")
USER_ERRORS = {"ConfigError", "LogError", "ResultError", "LimitError"}
OF_USER_ERROR = {"WrongArgumentError": "ConfigError", "TargetError": "ConfigError"}

Function = ast.FunctionDef


def functions_of(path: Path) -> Iterator[tuple[str, Function]]:
    """Yield the functions and methods of a module, with their names from the module on."""
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, Function):
            yield f"{path.name}: {node.name}", node
        elif isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, Function):
                    yield f"{path.name}: {node.name}.{inner.name}", inner


def public_functions() -> list[tuple[str, Function]]:
    """Return the public functions and methods of all modules."""
    found = []
    for path in MODULES:
        for name, function in functions_of(path):
            if not re.search(r"[ .]_", name):
                found.append((name, function))
    return found


def annotations_of(function: Function) -> list[str]:
    """Return what a function takes and gives, as it is written."""
    arguments = [*function.args.args, *function.args.kwonlyargs]
    kinds = [argument.annotation for argument in arguments] + [function.returns]
    return [ast.unparse(kind) for kind in kinds if kind is not None]


def raised_in(function: Function) -> set[str]:
    """Return the errors that a function raises itself."""
    found = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            name = ast.unparse(node.exc.func).rpartition(".")[2]
            if name.endswith("Error"):
                found.add(OF_USER_ERROR.get(name, name))
    return found


def called_in(function: Function) -> set[str]:
    """Return the names of the functions that a function calls."""
    calls = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
    return {call.id for call in calls if isinstance(call, ast.Name)}


def errors_by_function() -> dict[str, set[str]]:
    """Return the mistakes of users that each function raises, also by those that it calls; others are caught."""
    functions = [function for path in MODULES for _, function in functions_of(path)]
    errors: dict[str, set[str]] = {}
    for function in functions:
        errors.setdefault(function.name, set()).update(raised_in(function) & USER_ERRORS)
    is_new = True
    while is_new:
        is_new = False
        for function in functions:
            for name in called_in(function) & errors.keys():
                is_new |= not errors[name] <= errors[function.name]
                errors[function.name] |= errors[name]
    return errors


def unsaid_shapes() -> list[str]:
    """Return the functions of arrays whose docstring has no shape."""
    gaps = []
    for name, function in public_functions():
        kinds = " ".join(annotations_of(function))
        if ARRAYS.search(kinds) and not SHAPE.search(ast.get_docstring(function) or ""):
            gaps.append(name)
    return gaps


def unsaid_units() -> list[str]:
    """Return the functions of numbers and times whose docstring has no unit."""
    gaps = []
    for name, function in public_functions():
        kinds = " ".join(annotations_of(function))
        if NUMBERS.search(kinds) and not UNIT.search(ast.get_docstring(function) or ""):
            gaps.append(name)
    return gaps


def unsaid_errors() -> list[str]:
    """Return the functions with the errors that their docstring does not name."""
    known = errors_by_function()
    gaps = []
    for name, function in public_functions():
        errors = set(raised_in(function))
        for called in called_in(function):
            errors |= known.get(called, set())
        text = ast.get_docstring(function) or ""
        unsaid = sorted(error for error in errors if error not in text)
        if unsaid:
            gaps.append(f"{name}: {', '.join(unsaid)}")
    return gaps


def unsaid_parameters() -> list[str]:
    """Return the parameters of the public functions of `api` that are not in its docstring."""
    gaps = []
    for name, function in public_functions():
        arguments = [*function.args.args, *function.args.kwonlyargs]
        text = ast.get_docstring(function) or ""
        for argument in arguments:
            is_said = re.search(rf"^[\w, ]*\b{argument.arg}\b[\w, ]* : ", text, re.MULTILINE)
            if name.startswith("api.py") and argument.arg != "self" and not is_said:
                gaps.append(f"{name}: {argument.arg}")
    return gaps


def comment_of(lines: list[str], line: int) -> str:
    """Return the comment behind a line, and those above it."""
    comment = lines[line].partition("#")[2]
    above = line - 1
    while lines[above].lstrip().startswith("#"):
        comment += lines[above]
        above -= 1
    return comment


def unsaid_fields() -> list[str]:
    """Return the arrays among the fields of classes that have no comment with a shape."""
    gaps = []
    for path in MODULES:
        text = path.read_text("utf-8")
        for node in ast.parse(text).body:
            if not isinstance(node, ast.ClassDef):
                continue
            for field in node.body:
                if not isinstance(field, ast.AnnAssign):
                    continue
                comment = comment_of(text.splitlines(), field.lineno - 1)
                if ARRAYS.search(ast.unparse(field.annotation)) and not SHAPE.search(comment):
                    gaps.append(f"{path.name}: {node.name}.{ast.unparse(field.target)}")
    return gaps


GAPS = [unsaid_shapes, unsaid_units, unsaid_errors, unsaid_parameters, unsaid_fields]


@pytest.mark.parametrize("find", GAPS, ids=lambda find: find.__name__)
def test_docstrings_say_what_a_caller_needs(find: Callable[[], list[str]]) -> None:
    assert find() == []
