"""Numbers of compiled functions and loaded modules in a fresh process."""

import gc
import json
import subprocess
import sys

import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.cli._bundled import ASSETS
from splatwire.cli.main import VERBS, main
from splatwire.io.formats import write_splats

pytestmark = pytest.mark.slow

HEAVY = {"torch", "numba", "scipy", "matplotlib", "PIL", "ray", "pyarrow", "aioquic", "numpy", "typeguard", "asyncio"}
_COUNT = """
import json, sys
import numpy as np
from numba.core import event

class Compiled(event.Listener):
    found = []
    def on_start(self, e):
        arguments = [str(a) for a in e.data["args"]]
        self.found.append([e.data["dispatcher"].py_func.__qualname__, arguments])
    def on_end(self, e):
        pass

event.register("numba:compile", Compiled())
sys.path.insert(0, "tests")
from scenes import tiny_scene
from splatwire import Packetization, decode_stream, encode_scene
decode_stream(encode_scene(tiny_scene(num_anchors=120), Packetization(block_size=60)))
print(json.dumps(Compiled.found))
"""

_HELP = """
import json, os, sys
from splatwire.cli.main import main

loaded = {}
for verb in json.load(sys.stdin):
    reads, writes = os.pipe()
    if os.fork():
        os.close(writes)
        with open(reads) as answer:
            loaded[verb] = answer.read()
        assert os.wait()[1] == 0
        continue
    with open(os.devnull, "w") as sys.stdout:
        try:
            main([verb, "--help"])
        except SystemExit as end:
            assert not end.code
    os.write(writes, " ".join(sorted(sys.modules.keys() & sys.argv[1:])).encode())
    os._exit(0)
print(json.dumps(loaded))
"""
"""Prints the modules named as arguments that each verb's help loads."""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory, pytestconfig):
    """Compilations of one round trip in a fresh process with an empty cache."""
    import os

    # Without optimisation, which does not change types, compiling takes two thirds of the time.
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("cache")), "NUMBA_OPT": "0"}
    done = subprocess.run(
        [sys.executable, "-c", _COUNT], cwd=pytestconfig.rootpath, env=environment, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


@pytest.mark.extended
def test_the_codec_compiles_each_of_its_functions_once(compiled):
    """A second set of argument types would compile the function and its callees again."""
    names = [name for name, _ in compiled if "<locals>" not in name]
    assert len(names) > 20
    assert sorted(names) == sorted(set(names))


@pytest.mark.extended
def test_codec_compiles_no_literal_types_and_no_strings(compiled):
    assert not [call for call in compiled if "<locals>" not in call[0] and "Literal" in str(call[1])]
    assert not [call for call in compiled if "raise_with_shape" in call[0] or "unicode" in str(call[1])]


@pytest.fixture(scope="module")
def loaded_by_help() -> dict[str, str]:
    """Heavy modules that the help of each verb loads, as one text.

    Each verb runs in a fork of a process that has loaded the entry point, which all verbs need.
    """
    done = subprocess.run(
        [sys.executable, "-c", _HELP, *sorted(HEAVY)], input=json.dumps([*VERBS]), capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("verb", VERBS)
def test_help_loads_no_heavy_module(loaded_by_help, verb):
    assert loaded_by_help[verb] == ""


@pytest.mark.parametrize("stream", ["snowmiku.swz", "snowmiku_gaussians.swz"])
def test_inspecting_a_stream_imports_no_codec_of_a_schema(stream):
    """The side information suffices; importing numba, scipy and jaxtyping would take most of the time."""
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        f"try:\n    main(['inspect', {str(ASSETS / stream)!r}])\nexcept SystemExit as end:\n    assert not end.code\n"
        "found = {'torch', 'numba', 'scipy', 'jaxtyping', 'PIL', 'asyncio', 'splatwire.codec.gaussians.decoder',"
        " 'splatwire.codec.anchors.hacpp.decoder'}\n"
        "found &= set(sys.modules)\n"
        "sys.exit(str(found) if found else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_encoding_levels_of_a_ply_loads_no_unneeded_module(tmp_path):
    write_splats([some_splats(200)], tmp_path / "scene.ply")
    words = ["encode", str(tmp_path / "scene.ply"), "-o", str(tmp_path / "scene.swz"), "--levels", "auto"]
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        f"try:\n    main({words})\nexcept SystemExit as end:\n    assert not end.code\n"
        "found = {'torch', 'scipy.linalg', 'scipy.special', 'scipy.ndimage', 'rich', 'splatwire.neural.training',"
        " 'splatwire.sequence.decoding', 'splatwire.data.dataset'} & set(sys.modules)\n"
        "sys.exit(str(found) if found else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_encoding_gaussians_imports_no_codec_of_other_scenes(tmp_path):
    write_splats([some_splats(200)], tmp_path / "scene.ply")
    words = ["encode", str(tmp_path / "scene.ply"), "-o", str(tmp_path / "scene.swz")]
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        f"try:\n    main({words})\nexcept SystemExit as end:\n    assert not end.code\n"
        "others = ('splatwire.codec.anchors', 'splatwire.codec.sequence', 'splatwire.sequence.encoding',"
        " 'splatwire.io.formats.sog', 'splatwire.io.formats.gltf')\n"
        "found = [name for name in sys.modules if name.startswith(others)]\n"
        "sys.exit(str(found) if found else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_garbage_collection_is_restored_after_a_verb(capsys):
    before = gc.get_threshold()
    with pytest.raises(SystemExit):
        main(["--version"])
    assert gc.get_threshold() == before
