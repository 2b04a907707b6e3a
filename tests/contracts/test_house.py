"""The measures of the house: short functions, no circles, nobody reaches into another's private parts."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import splatwire

SOURCE = Path(splatwire.__file__).parent
MOST_FUNCTION_LINES = 60

_TREES: dict[str, tuple[Path, ast.Module]] = {}
for _path in sorted(SOURCE.rglob("*.py")):
    _words = _path.relative_to(SOURCE.parent).with_suffix("").parts
    _name = ".".join(_words[:-1] if _words[-1] == "__init__" else _words)
    _TREES[_name] = _path, ast.parse(_path.read_text(encoding="utf-8"))


def test_functions_are_short():
    long = {}
    for name, (_, tree) in _TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                lines = (node.end_lineno or 0) - node.lineno + 1
                if lines > MOST_FUNCTION_LINES:
                    long[f"{name}.{node.name}"] = lines
    assert long == {}


def test_no_circle_of_imports_even_of_deferred_ones():
    graph = {name: set(_imports(tree)) - {name} for name, (_, tree) in _TREES.items()}
    assert _circles(graph) == []


def test_no_private_name_crosses_a_module():
    """A name with an underscore belongs to its file; a file with an underscore to its folder."""
    found = []
    for name, (_, tree) in _TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("splatwire"):
                found += [
                    f"{name}: {node.module}.{a.name}" for a in node.names if _is_foreign(name, node.module, a.name)
                ]
    assert found == []


@pytest.mark.parametrize("name", sorted(_TREES))
def test_everything_public_says_what_it_is(name):
    silent = [node.name for node in _public(_TREES[name][1]) if ast.get_docstring(node) is None]
    assert silent == []


def _public(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            yield node


def _is_foreign(importer: str, module: str, name: str) -> bool:
    if f"{module}.{name}" in _TREES:
        module, name = f"{module}.{name}", ""
    private_file = next((i for i, word in enumerate(module.split(".")) if word.startswith("_")), None)
    if name.startswith("_") and not name.startswith("__"):
        return True
    return private_file is not None and not importer.startswith(".".join(module.split(".")[:private_file]) + ".")


def _imports(tree: ast.Module) -> Iterator[str]:
    """Modules of ours that a module imports, at any depth, but for those that only type checkers see."""
    for node in _without_type_checking(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name in _TREES)
        elif isinstance(node, ast.ImportFrom) and node.module in _TREES:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in _TREES else node.module


def _without_type_checking(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        yield node
        yield from _without_type_checking(node)


def _circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components of more than one module (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            circle = []
            while not circle or circle[-1] != node:
                circle.append(stack.pop())
            if len(circle) > 1:
                found.append(sorted(circle))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found
