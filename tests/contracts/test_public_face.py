"""The public face: what it promises is there, light to import, and typed."""

import ast
import importlib
import inspect
import runpy
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


@pytest.mark.parametrize("room", ["scene_io", "scene", "model", "formats", "packets", "channel", "codec", "conceal",
                                  "render", "data", "metrics", "evaluate"])  # fmt: skip
def test_rooms_export_what_they_announce(room):
    module = importlib.import_module(f"splatwire.{room}")
    assert module.__all__
    assert len(set(module.__all__)) == len(module.__all__)
    assert [name for name in module.__all__ if not hasattr(module, name)] == []


NOT_IN_THE_REFERENCE = {
    "cli": "its verbs have a page of their own",
    "entropy": "integers and bytes, which only the codec calls",
    "files": "what readers of files share",
    "ops": "kernels that other rooms call",
}


def test_every_room_is_in_the_reference():
    pytest.importorskip("mkdocs")
    pages = runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs" / "reference.py"))
    rooms = {path.name for path in Path(splatwire.__file__).parent.iterdir() if (path / "__init__.py").exists()}
    shown = {room.partition(".")[0] for room in pages["ROOMS"]}
    assert rooms - shown == set(NOT_IN_THE_REFERENCE)
    names = {room: pages["public_names"](importlib.import_module(f"splatwire.{room}")) for room in pages["ROOMS"]}
    assert all(names.values())
    text = "".join(pages["_python"]())
    for name in ("import_hacpp", "import_scaffold", "fit_splats", "read_splats", "preview_for_scene", "plan_protection",
                 "load_study"):  # fmt: skip
        assert f".{name}\n" in text


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
