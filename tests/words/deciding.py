"""Finds where code asks a sentence: what an error says, or whether a text is, holds or begins with one."""

import ast
from collections.abc import Iterator
from typing import Final

from wordless import FEWEST_WORDS, is_sentence, words_of

# A stored word or code of results has at most so many words; what has more is a sentence.
MOST_WORDS_OF_A_CODE: Final = FEWEST_WORDS + 1
_ASKED_FOR: Final = (ast.In, ast.NotIn, ast.Eq, ast.NotEq)
# Methods of a text that look for another one in it.
_LOOKS: Final = frozenset(
    (
        "startswith",
        "endswith",
        "removeprefix",
        "removesuffix",
        "partition",
        "rpartition",
        "find",
        "rfind",
        "index",
        "count",
    )
)
_PATTERNS: Final = frozenset(("match", "search", "fullmatch", "findall", "finditer"))
# What an error or a note says to people.
_SAID: Final = frozenset(("text", "what", "message", "hint", "sentence", "args"))


class _Deciding(ast.NodeVisitor):
    """Collects the places of one module."""

    def __init__(self, tree: ast.Module) -> None:
        self.found: list[str] = []
        self.prose = {*_sentences_by_name(tree)}
        self.errors: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.ExceptHandler) and node.name:
                self.errors.add(node.name)

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        is_asked = any(isinstance(operator, _ASKED_FOR) for operator in node.ops)
        if is_asked and any(self._is_prose(one) or self._is_said(one) for one in operands):
            self.found.append(ast.unparse(node))
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        if isinstance(node.func, ast.Attribute):
            receiver = node.func.value
            looks = node.func.attr in _LOOKS
            if looks and (self._is_said(receiver) or any(map(self._is_prose, node.args))):
                self.found.append(ast.unparse(node))
            is_pattern = node.func.attr in _PATTERNS and ast.unparse(receiver) == "re"
            if is_pattern and any(map(self._is_said, node.args)):
                self.found.append(ast.unparse(node))
        self.generic_visit(node)

    def _is_prose(self, node: ast.expr) -> bool:
        """Return whether this is a sentence, a name for one, or several."""
        match node:
            case ast.Constant(value=str() as text):
                return is_sentence(text)
            case ast.Name(id=name):
                return name in self.prose
            case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Set(elts=parts):
                return any(map(self._is_prose, parts))
        return False

    def _is_said(self, node: ast.expr) -> bool:
        """Return whether this is what an error says."""
        match node:
            case ast.Call(func=ast.Name(id="str"), args=[ast.Name(id=name)]):
                return name in self.errors
            case ast.Attribute(value=ast.Name(id=name), attr=attribute):
                return name in self.errors and attribute in _SAID
        return False


def _sentences_by_name(tree: ast.Module) -> Iterator[str]:
    """Yield the names of constants of a module that are sentences, or hold some; of a table its keys count."""
    for node in tree.body:
        match node:
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                pass
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                pass
            case _:
                continue
        parts: list[ast.AST] = [value]
        if isinstance(value, ast.Dict):
            parts = [key for key in value.keys if key is not None]
        for part in parts:
            if any(map(_is_text_of_words, ast.walk(part))):
                yield name


def _is_text_of_words(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Constant) and isinstance(node.value, str) and is_sentence(node.value)
    )


def decided_by_prose(source: str) -> list[str]:
    """Return the expressions of a module that ask a sentence."""
    tree = ast.parse(source)
    deciding = _Deciding(tree)
    deciding.visit(tree)
    return deciding.found


def is_too_long_for_a_code(text: str) -> bool:
    """Return whether a stored word is a sentence."""
    return words_of(text) > MOST_WORDS_OF_A_CODE
