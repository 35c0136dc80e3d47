"""Import the package with every sentence replaced by "x", and tell what its commands decide all the same.

`python tests/words/wordless.py FOLDER COMMANDS` prints the decisions on the logs in a folder as JSON. The commands are
JSON, too.
"""

import ast
import importlib.abc
import importlib.machinery
import json
import re
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Final, TypeVar

X: Final = "x"
PACKAGE: Final = "insdvl_replay"
# A text with so many words is a sentence, and no name, key or format.
FEWEST_WORDS: Final = 3
_WORD: Final = re.compile(r"[A-Za-z][a-z']+[,.;:]?")
_Body = TypeVar("_Body", ast.Module, ast.ClassDef, ast.FunctionDef)


def words_of(text: str) -> int:
    """Count the words of a text."""
    return sum(_WORD.fullmatch(part) is not None for part in text.split())


def is_sentence(text: str) -> bool:
    """Return whether a text is written for people."""
    return words_of(text) >= FEWEST_WORDS


def without_words(text: str) -> str:
    """Return a sentence without its words; a comment of a file stays one, and a line ends."""
    comment = "# " if text.startswith("#") else ""
    end = "\n" if text.endswith("\n") else ""
    return f"{comment}{X}{end}"


class Wordless(ast.NodeTransformer):
    """Replaces sentences in code; docstrings, annotations, patterns and the words of results stay."""

    def __init__(self) -> None:
        self.replaced: list[str] = []

    def visit_Module(self, node: ast.Module) -> ast.Module:
        return self._body(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        self.visit(node.args)
        return self._body(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        # Members of an enumeration are words of results, which files and scripts use.
        if any(isinstance(base, ast.Name) and base.id == "StrEnum" for base in node.bases):
            return node
        return self._body(node)

    def visit_arg(self, node: ast.arg) -> ast.arg:
        return node  # with its annotation

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AnnAssign:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        function = node.func
        is_pattern = (
            isinstance(function, ast.Attribute)
            and isinstance(function.value, ast.Name)
            and function.value.id == "re"
        )
        if is_pattern:
            return node
        return self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        if isinstance(node.value, str) and is_sentence(node.value):
            return self._x(node.value, node)
        return node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        written = [
            str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values
        ]
        text = "".join(written)
        if is_sentence(text):
            return self._x(text, node)
        return self.generic_visit(node)

    def _x(self, text: str, node: ast.expr) -> ast.Constant:
        self.replaced.append(text)
        return ast.copy_location(ast.Constant(without_words(text)), node)

    def _body(self, node: _Body) -> _Body:
        first = node.body[0] if node.body else None
        kept: list[ast.stmt] = []
        is_docstring = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
        if first is not None and is_docstring:
            kept = [first]
        node.body = kept + [self.visit(statement) for statement in node.body[len(kept) :]]
        return node


class _Loader(SourceFileLoader):
    """Loads a module without its sentences, and without any byte code of it."""

    def __init__(self, loader: SourceFileLoader, replaced: list[str]) -> None:
        super().__init__(loader.name, loader.path)
        self._replaced = replaced

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        wordless = Wordless()
        tree = ast.fix_missing_locations(wordless.visit(ast.parse(self.get_data(path))))
        self._replaced += wordless.replaced
        return compile(tree, path, "exec", dont_inherit=True)


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the modules of the package."""

    def __init__(self) -> None:
        self.replaced: list[str] = []  # the sentences of the modules that were imported

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname.partition(".")[0] != PACKAGE:
            return None
        for finder in sys.meta_path:
            spec = None if finder is self else finder.find_spec(fullname, path, target)
            if spec is not None and isinstance(spec.loader, SourceFileLoader):
                spec.loader = _Loader(spec.loader, self.replaced)
                return spec
        return None


def without_sentences() -> _Finder:
    """Import the package without its sentences from now on; errors and notes say "x", whatever they are given."""
    assert PACKAGE not in sys.modules
    found = _Finder()
    sys.meta_path.insert(0, found)
    from insdvl_replay.core.errors import Note, UserError

    UserError.__init__ = error_of_x(UserError.__init__)  # type: ignore[method-assign]
    Note.__init__ = note_of_x(Note.__init__)  # type: ignore[method-assign]
    return found


def error_of_x(as_written: Callable[..., None]) -> Callable[..., None]:
    """Return how an error is made that says "x", without its places."""

    def make(error: Exception, what: str, hint: str = "", *_: object) -> None:
        as_written(error, X if what else "", X if hint else "")

    return make


def note_of_x(as_written: Callable[..., None]) -> Callable[..., None]:
    """Return how a note is made that says "x": its sentences are in a table and not in the code."""

    def make(
        note: object, code: str, text: str, count: int, severity: str, hint: str = ""
    ) -> None:
        as_written(note, code, X if text else "", count, severity, X if hint else "")

    return make


def main() -> None:
    """Print the decisions, and how many sentences were left out."""
    folder = Path(sys.argv[1])
    sys.path.insert(1, str(Path(__file__).parents[1]))
    found = without_sentences()
    from decisions import decisions

    commands = json.loads(sys.argv[2])
    told = {"decisions": decisions(folder, commands), "replaced": len(found.replaced)}
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    main()
