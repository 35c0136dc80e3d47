"""How readable the code of the package is, in numbers that are held at least as good as they are.

``python tests/house.py`` prints each number beside its ceiling and its goal, and the functions with
the most decisions. ``python tests/house.py --tighten`` lowers the ceilings in ``tests/house.csv``
to what is reached; nothing raises them.
"""

import argparse
import ast
import csv
import io
import keyword
import math
import sys
import tokenize
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
PACKAGE = PROJECT / "insdvl_replay"
TABLE = PROJECT / "tests" / "house.csv"

MOST_DECISIONS = 15
FAR_TOO_MANY = 25
LONGEST_LINE = 100
EXCEPTED = ("nav/filter.py", "_run")
"""The loop of the filter is one function, because a call in each step would cost too much time."""
FORMULAS = ("nav", "geometry")
"""Rooms where a packed tuple is often a formula."""
ROOMS = {
    "show": ("show", "document"),
    "changes": ("changes",),
    "inspection": ("inspection",),
    "batch": ("batch",),
}
"""Rooms whose expressions are held one by one, with their folders."""

FunctionNode = ast.FunctionDef | ast.AsyncFunctionDef
Comprehension = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp


@dataclass(frozen=True)
class Page:
    """A file of code."""

    name: str  # its path in the package
    nodes: tuple[ast.AST, ...]  # of its tree
    code_lines: tuple[str, ...]  # without docstrings, comments and empty lines
    identifiers: int  # in the lines of code

    @property
    def room(self) -> str:
        """The folder that the file stands in."""
        return self.name.partition("/")[0]


@dataclass(frozen=True)
class Function:
    """A function and its decisions."""

    page: str
    line: int
    name: str
    complexity: int


@dataclass(frozen=True)
class End:
    """A number that may fall and not rise: a line of the table."""

    name: str
    ceiling: float
    goal: float
    step: float  # of the ceiling


# Reading


def read_package(folder: Path) -> list[Page]:
    """Read all files of code below a folder."""
    paths = sorted(folder.rglob("*.py"))
    return [
        read_page(path.read_text("utf-8"), path.relative_to(folder).as_posix()) for path in paths
    ]


def read_page(source: str, name: str) -> Page:
    """Take a file apart into its tree and its lines of code."""
    nodes = tuple(ast.walk(ast.parse(source)))
    lines = source.splitlines()
    identifiers = 0
    code = set[int]()
    documentation = _documentation_lines(nodes)
    for token in _tokens_of_code(source):
        code.update(range(token.start[0], token.end[0] + 1))
        if token.start[0] not in documentation and _is_identifier(token):
            identifiers += 1
    code -= documentation
    return Page(
        name,
        nodes,
        tuple(lines[number - 1] for number in sorted(code)),
        identifiers,
    )


def _documentation_lines(nodes: Iterable[ast.AST]) -> set[int]:
    """Return the numbers of the lines of docstrings, and of strings that stand behind a name."""
    found = set[int]()
    for node in nodes:
        if not isinstance(node, ast.Module | ast.ClassDef | FunctionNode):
            continue
        for statement in node.body:
            if _is_documentation(statement):
                found.update(range(statement.lineno, (statement.end_lineno or 0) + 1))
    return found


def _is_documentation(statement: ast.stmt) -> bool:
    if not isinstance(statement, ast.Expr) or not isinstance(statement.value, ast.Constant):
        return False
    return isinstance(statement.value.value, str)


def _tokens_of_code(source: str) -> Iterator[tokenize.TokenInfo]:
    """Yield the tokens that are neither comments nor layout."""
    layout = {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
    # Python 3.12 and newer tell the names inside a formatted string. They are left out, so that
    # each Python counts the same.
    opening = getattr(tokenize, "FSTRING_START", None)
    closing = getattr(tokenize, "FSTRING_END", None)
    open_strings = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == opening:
            open_strings += 1
        elif token.type == closing:
            open_strings -= 1
        inside = open_strings > 0 and token.type == tokenize.NAME
        if token.type not in layout and not inside:
            yield token


def _is_identifier(token: tokenize.TokenInfo) -> bool:
    return token.type == tokenize.NAME and not keyword.iskeyword(token.string)


# Counting


def complexity(function: ast.AST) -> int:
    """Return one more than the decisions of a function and of the functions inside it."""
    return 1 + sum(_decisions(node) for node in ast.walk(function))


def _decisions(node: ast.AST) -> int:
    if isinstance(node, ast.BoolOp):
        return len(node.values) - 1
    if isinstance(node, ast.comprehension):
        return 1 + len(node.ifs)
    branches = (
        ast.If,
        ast.IfExp,
        ast.For,
        ast.AsyncFor,
        ast.While,
        ast.ExceptHandler,
        ast.Assert,
        ast.match_case,
    )
    return 1 if isinstance(node, branches) else 0


def functions_of(pages: Iterable[Page]) -> list[Function]:
    """Return all functions except the loop of the filter, those with the most decisions first."""
    found = []
    for page in pages:
        for node in page.nodes:
            if isinstance(node, FunctionNode) and (page.name, node.name) != EXCEPTED:
                found.append(Function(page.name, node.lineno, node.name, complexity(node)))
    return sorted(found, key=lambda function: (-function.complexity, function.page, function.line))


def _is_packed(node: ast.AST) -> bool:
    """Tell whether a statement is like ``a, b = x, y``."""
    if not isinstance(node, ast.Assign):
        return False
    return isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)


def _is_conditional(node: ast.AST) -> bool:
    return isinstance(node, ast.IfExp)


def _is_comprehension(node: ast.AST) -> bool:
    return isinstance(node, Comprehension)


def nested(node: ast.AST) -> int:
    """Return 1 each where a comprehension has two loops, and where it holds another comprehension."""
    if not isinstance(node, Comprehension):
        return 0
    count = 0
    if len(node.generators) > 1:
        count += 1
    if any(inner is not node and _is_comprehension(inner) for inner in ast.walk(node)):
        count += 1
    return count


def _per_thousand(pages: Iterable[Page], count: Callable[[ast.AST], int]) -> float:
    """Return how often something occurs in 1,000 lines of code."""
    occurrences = 0
    lines = 0
    for page in pages:
        occurrences += sum(count(node) for node in page.nodes)
        lines += len(page.code_lines)
    return 1000 * occurrences / lines if lines else 0.0


def measure(pages: Sequence[Page]) -> dict[str, float]:
    """Return all numbers that have an end."""
    decisions = [function.complexity for function in functions_of(pages)]
    lines = [line for page in pages for line in page.code_lines]
    long_lines = sum(len(line) > LONGEST_LINE for line in lines)
    identifiers = sum(page.identifiers for page in pages)
    no_formulas = [page for page in pages if page.room not in FORMULAS]
    values: dict[str, float] = {
        f"functions above {MOST_DECISIONS} decisions": sum(n > MOST_DECISIONS for n in decisions),
        f"functions above {FAR_TOO_MANY} decisions": sum(n > FAR_TOO_MANY for n in decisions),
        "packed tuples per 1000 lines": _per_thousand(no_formulas, _is_packed),
        "nested comprehensions per 1000 lines": _per_thousand(pages, nested),
        f"lines above {LONGEST_LINE} letters in %": 100 * long_lines / max(1, len(lines)),
        "identifiers per line": identifiers / max(1, len(lines)),
    }
    for room, folders in ROOMS.items():
        own = [page for page in pages if page.room in folders]
        values[f"{room}: conditional expressions per 1000 lines"] = _per_thousand(
            own, _is_conditional
        )
        values[f"{room}: comprehensions per 1000 lines"] = _per_thousand(own, _is_comprehension)
    return values


# The table of ends


def read_ends(file: Path = TABLE) -> list[End]:
    """Read the ceilings and goals."""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    ends = []
    for row in rows:
        step = float(row["step"])
        ends.append(End(row["end"], float(row["ceiling"]), float(row["goal"]), step))
    return ends


def tightened(ends: Iterable[End], values: Mapping[str, float]) -> list[End]:
    """Lower each ceiling to what is reached; where a number is above its ceiling, that stays."""
    lowered = []
    for end in ends:
        reached = rounded_up(values[end.name], end.step)
        lowered.append(replace(end, ceiling=min(end.ceiling, reached)))
    return lowered


def rounded_up(value: float, step: float) -> float:
    """Return the lowest multiple of a step that is not below a value."""
    return round(math.ceil(value / step - 1e-9) * step, 9)


def write_ends(ends: Iterable[End], file: Path = TABLE) -> None:
    """Store the ceilings."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["end", "ceiling", "goal", "step"])
        for end in ends:
            writer.writerow([end.name, f"{end.ceiling:g}", f"{end.goal:g}", f"{end.step:g}"])


def too_high(ends: Iterable[End], values: Mapping[str, float]) -> list[str]:
    """Say which numbers are above their ceilings."""
    sentences = []
    for end in ends:
        value = values[end.name]
        if value > end.ceiling:
            sentences.append(f"{end.name}: {value:.2f} is above the ceiling of {end.ceiling:g}")
    return sentences


def can_be_lowered(ends: Iterable[End], values: Mapping[str, float]) -> list[str]:
    """Name the ends whose ceilings are higher than they need to be."""
    return [end.name for end in ends if rounded_up(values[end.name], end.step) < end.ceiling]


def summary(
    ends: Sequence[End], values: Mapping[str, float], functions: Sequence[Function]
) -> str:
    """Write the table, the functions with the most decisions, and what is wrong or can be lowered."""
    lines = [f"{'':50}{'is':>9}{'ceiling':>9}{'goal':>9}"]
    for end in ends:
        lines.append(f"{end.name:50}{values[end.name]:9.2f}{end.ceiling:9g}{end.goal:9g}")
    lines.append("")
    for function in functions:
        place = f"{function.page}:{function.line}"
        lines.append(f"{function.complexity:3} decisions in {place} {function.name}")
    lower = can_be_lowered(ends, values)
    if lower:
        lines += ["", "better than its ceiling: " + "; ".join(lower)]
        lines.append("`python tests/house.py --tighten` lowers the ceilings")
    wrong = too_high(ends, values)
    if wrong:
        lines += ["", *wrong]
    return "\n".join(lines)


def main() -> int:
    """Print the numbers, and lower their ceilings where that is asked for."""
    parser = argparse.ArgumentParser(description="How readable the code of the package is.")
    parser.add_argument("--tighten", action="store_true", help="lower the ceilings")
    parser.add_argument("--worst", type=int, default=25, help="how many functions are listed")
    asked = parser.parse_args()

    pages = read_package(PACKAGE)
    values = measure(pages)
    ends = read_ends()
    if asked.tighten:
        ends = tightened(ends, values)
        write_ends(ends)
    told = summary(ends, values, functions_of(pages)[: asked.worst])
    sys.stdout.write(f"{told}\n")
    return 1 if too_high(ends, values) else 0


if __name__ == "__main__":
    sys.exit(main())
