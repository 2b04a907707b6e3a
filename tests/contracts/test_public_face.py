"""The public face: what it promises is there, light to import, and typed."""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import splatwire


def test_all_names_exist_and_are_what_they_are_called():
    for name in splatwire.__all__:
        value = getattr(splatwire, name)
        assert name == "__version__" or value.__name__ == name


def test_dir_shows_the_face():
    assert set(splatwire.__all__) <= set(dir(splatwire))


def test_type_checkers_see_the_same_names():
    """The lazy names are declared once more for type checkers; both lists must agree, homes included."""
    tree = ast.parse(inspect.getsource(splatwire))
    guard = next(node for node in tree.body if isinstance(node, ast.If))
    declared = {
        alias.asname: node.module for node in guard.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert declared == splatwire._HOME


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="teleport"):
        splatwire.teleport  # noqa: B018


def test_no_name_hides_a_room():
    """`splatwire.render` must stay the package, whatever was imported first."""
    rooms = {path.name for path in Path(splatwire.__file__).parent.iterdir() if (path / "__init__.py").exists()}
    assert not rooms & set(splatwire.__all__)


@pytest.mark.parametrize("room", ["scene", "model", "packets", "channel", "codec", "conceal", "render", "data",
                                  "metrics", "evaluate"])  # fmt: skip
def test_rooms_export_what_they_announce(room):
    module = importlib.import_module(f"splatwire.{room}")
    public = [name for name in vars(module) if not name.startswith("_")]
    assert public
    assert set(getattr(module, "__all__", public)) <= set(public)


def test_importing_the_package_loads_nothing():
    code = (
        "import sys, splatwire\nheavy = {'torch', 'numpy', 'numba'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_module_imports_on_its_own():
    """A module that only works after another was imported breaks for the user who imports it first."""
    root = Path(splatwire.__file__).parent
    for path in sorted(root.rglob("*.py")):
        words = path.relative_to(root.parent).with_suffix("").parts
        if words[-1] == "__main__":
            continue
        name = ".".join(words[:-1] if words[-1] == "__init__" else words)
        importlib.import_module(name)
