"""Import cycles, private names and missing docstrings in `src/splatwire`."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import splatwire

SOURCE = Path(splatwire.__file__).parent


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """Syntax trees by name of the module; a fixture, because each test process collects this file."""
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        words = path.relative_to(SOURCE.parent).with_suffix("").parts
        name = ".".join(words[:-1] if words[-1] == "__init__" else words)
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def test_imports_have_no_cycle_even_deferred_ones(trees):
    graph = {name: set(_imports(tree, trees)) - {name} for name, tree in trees.items()}
    assert _cycles(graph) == []


MAX_DEFERRED_IMPORTS = 48
"""Imports inside functions of `src/splatwire`: each serves start-up or an optional extra. The number may only fall."""


def test_deferred_imports_do_not_grow(trees):
    found = [
        f"{name}: {ast.unparse(inner)}"
        for name, tree in trees.items()
        for outer in ast.walk(tree)
        if isinstance(outer, (ast.FunctionDef, ast.AsyncFunctionDef))
        for inner in ast.walk(outer)
        if isinstance(inner, (ast.Import, ast.ImportFrom))
    ]
    assert len(found) <= MAX_DEFERRED_IMPORTS, sorted(found)


def test_private_names_are_not_imported_by_other_modules(trees):
    """A name with an underscore is private to its file, a file with an underscore to its folder."""
    found = []
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("splatwire"):
                found += [
                    f"{name}: {node.module}.{a.name}"
                    for a in node.names
                    if _is_foreign(name, node.module, a.name, trees)
                ]
    assert found == []


def test_public_names_have_docstrings(trees):
    silent = [
        f"{name}.{node.name}"
        for name, tree in trees.items()
        for node in _public(tree)
        if ast.get_docstring(node) is None
    ]
    assert silent == []


def _public(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            yield node


def _is_foreign(importer: str, module: str, name: str, trees: dict[str, ast.Module]) -> bool:
    if f"{module}.{name}" in trees:
        module, name = f"{module}.{name}", ""
    private_file = next((i for i, word in enumerate(module.split(".")) if word.startswith("_")), None)
    if name.startswith("_") and not name.startswith("__"):
        return True
    return private_file is not None and not importer.startswith(".".join(module.split(".")[:private_file]) + ".")


def _imports(tree: ast.Module, trees: dict[str, ast.Module]) -> Iterator[str]:
    """Names of the splatwire modules that a module imports at any depth, except under `TYPE_CHECKING`."""
    for node in _without_type_checking(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name in trees)
        elif isinstance(node, ast.ImportFrom) and node.module in trees:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in trees else node.module


def _without_type_checking(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        yield node
        yield from _without_type_checking(node)


def _cycles(graph: dict[str, set[str]]) -> list[list[str]]:
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
            cycle = []
            while not cycle or cycle[-1] != node:
                cycle.append(stack.pop())
            if len(cycle) > 1:
                found.append(sorted(cycle))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found
