"""What a fresh machine compiles and loads: numbers of things, never seconds."""

import gc
import json
import subprocess
import sys

import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.cli.main import VERBS, main
from splatwire.formats import write_splats

HEAVY = {"torch", "numba", "scipy", "matplotlib", "PIL", "ray", "pyarrow", "aioquic", "numpy"}
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


@pytest.fixture(scope="module")
def compiled(tmp_path_factory, pytestconfig):
    """All that a round trip of a scene compiles in a fresh process with an empty cache."""
    import os

    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("cache"))}
    done = subprocess.run(
        [sys.executable, "-c", _COUNT], cwd=pytestconfig.rootpath, env=environment, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


def test_the_codec_compiles_each_of_its_functions_once(compiled):
    """A second set of types would be a second compilation of the function, and of all that it calls."""
    names = [name for name, _ in compiled if "<locals>" not in name]
    assert len(names) > 20
    assert sorted(names) == sorted(set(names))


def test_the_codec_compiles_no_number_as_a_type_and_no_text(compiled):
    assert not [call for call in compiled if "<locals>" not in call[0] and "Literal" in str(call[1])]
    assert not [call for call in compiled if "raise_with_shape" in call[0] or "unicode" in str(call[1])]


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_a_verb_loads_nothing_heavy(verb):
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        f"try:\n    main(['{verb}', '--help'])\nexcept SystemExit:\n    pass\n"
        f"sys.exit(str({HEAVY} & set(sys.modules)) if {HEAVY} & set(sys.modules) else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_encoding_a_ply_with_levels_loads_no_more_than_it_needs(tmp_path):
    write_splats([some_splats(200)], tmp_path / "scene.ply")
    words = ["encode", str(tmp_path / "scene.ply"), "-o", str(tmp_path / "scene.swz"), "--levels", "auto"]
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        f"try:\n    main({words})\nexcept SystemExit as end:\n    assert not end.code\n"
        "found = {'torch', 'scipy.linalg', 'splatwire.train', 'splatwire.clips.decoding'} & set(sys.modules)\n"
        "sys.exit(str(found) if found else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_garbage_is_looked_for_as_before_once_a_verb_has_run(capsys):
    before = gc.get_threshold()
    with pytest.raises(SystemExit):
        main(["--version"])
    assert gc.get_threshold() == before
