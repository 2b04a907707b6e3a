"""Unusual arguments of public functions work if they make sense, and otherwise give one error.

The test suite checks argument types and user programs do not, so calls run in a separate process.
"""

import dataclasses
import importlib
import json
import pkgutil
import re
import subprocess
import sys
import typing

import numpy as np
import pytest

import splatwire.anchors
import splatwire.bitstream
import splatwire.types

pytestmark = pytest.mark.slow

PRELUDE = """
import importlib, json, sys, numpy as np, splatwire
from pathlib import Path
from splatwire.concealment import conceal
from splatwire.data import load_cameras, open_dataset, save_cameras
from splatwire.evaluation import study
from splatwire.io.formats import read_content, read_splats, write_splats
from splatwire.types import Anchors, Cameras, LossMask, Gaussians, SplatScene
from splatwire.types.splats import Splats

g = np.random.default_rng(0)
def r(*shape): return g.random(shape, np.float32)
n = 300
splats = Splats(r(n, 3), r(n, 4), r(n, 3) * np.float32(0.05), r(n) * np.float32(0.9), r(n, 1, 3))
scene = SplatScene(splats)
viewmat = np.eye(4, dtype=np.float32)[None].copy(); viewmat[0, 2, 3] = 3.0
cameras = Cameras(viewmat, np.float32([[[30, 0, 16], [0, 30, 12], [0, 0, 1]]]), 32, 24, ("a",))
path = Path(sys.argv[1]) / "cameras.json"
save_cameras(cameras, path)
stream = splatwire.encode_scene(scene, "datagram")
splatwire.write_stream(stream, path.parent / "x.swz")
splatwire.save_scene(scene, path.parent / "y.ply")
received = splatwire.decode_stream(stream)
whole_clip = splatwire.encode([splats] * 3, splatwire.SequenceOptions(group_frames=2))
clip = splatwire.decode_stream(splatwire.transmit(whole_clip, "bernoulli:0.5", seed=1)[0])
(path.parent / "p.toml").write_text(
    '[[scene]]\\nname = "x"\\nstream = "x.swz"\\n[[row]]\\nkey = "a"\\nlabel = "a"\\n[[loss]]\\nmodel = "none"\\n'
)
protocol, store = study.load_study(str(path.parent / "p.toml")), study.Store(str(path.parent / "store"))
picture = splatwire.render_scene(scene, cameras, renderer="cpu")
class Tensor:  # as one of torch on a GPU or with gradients: only `detach().cpu()` can become an array
    def __init__(self, array): self.array = array
    def detach(self): return self
    def cpu(self): return self.array
def module(name): return importlib.import_module(f"splatwire.{name}")
def draw(scene=scene, cameras=cameras, **more):
    return splatwire.render_scene(scene, cameras, **{"renderer": "cpu", **more})
"""
WORKS = {
    "a path of cameras": "all(np.array_equal(draw(cameras=kind(path)), picture) for kind in (Path, str))",
    "what a decoder returns": "np.array_equal(draw(received), draw(received.scene))",
    "explicit Gaussians": "np.array_equal(draw(splats), picture)",
    "a background of numbers": "np.array_equal(draw(background=(0.0, 0.0, 0.0)), picture)",
    "a background of numpy": "draw(background=np.ones(3)).min() > 0.01 * 0 and draw(background=[1, 1, 1]).max() > 0.9",
    "a seed of numpy": "splatwire.transmit(stream, 'none', seed=np.int64(3))[1].seed == 3",
    "no seed, as on the command line": "splatwire.transmit(stream, 'bernoulli:0.2')[1].seed == 0",
    "a path of any kind": "splatwire.read_stream('x.swz')[0] == splatwire.read_stream(path.parent / 'x.swz')[0]",
    "a loss as text": "len(splatwire.transmit(stream, 'bernoulli:1', seed=0)[0].packets) == 0",
    "a preset by name": "stream == splatwire.encode_scene(splats, 'datagram')",
    "a whole decoded scene to encode": "len(splatwire.encode_scene(received, 'paper').packets) > 0",
    "tiers of numpy": "splatwire.encode_scene(scene, tiers=np.repeat([0, 1], n // 2).astype(np.uint8)) is not None",
    "one camera of several": "cameras[0].names == ('a',) == cameras[-1].names and [len(c) for c in cameras] == [1]",
    "some cameras": "len(cameras[:0]) == 0 and cameras[:5].names == ('a',)",
    "names of cameras in a list": "Cameras(viewmat, cameras.Ks, 32, 24, ['a']).names == ('a',)",
    "the path of Gaussians as text": "read_splats(str(path.parent / 'y.ply')).num_gaussians == n",
    "tiers in a list": "splatwire.encode_scene(scene, tiers=[0, 1] * (n // 2)) is not None",
    "classes of any whole numbers": "splatwire.encode_scene(scene, class_offsets=np.full(n, -3)) is not None",
    "explicit Gaussians to save": "splatwire.save_scene(splats, path.parent / 'x.ply') is None",
    "a background in a list": "SplatScene(splats, background=[1, 0.5, 0]).background == (1.0, 0.5, 0.0)",
    **{
        f"a background in {kind}": f"SplatScene(splats, background={kind}([1, 0.5, 0])).background == (1.0, 0.5, 0.0)"
        for kind in ("np.array", "np.float32")
    },
    "paths of a study as text": "study.SceneEntry('a', 'x.swz', 'stream').source == Path('x.swz')",
    "rows of a study in a list": "study.Study('a', 'a', [*protocol.scenes], [*protocol.rows], [*protocol.losses]) "
    "== study.Study('a', 'a', protocol.scenes, protocol.rows, protocol.losses)",
    "pictures in a list": "splatwire.evaluate(scene, [np.zeros((24, 32, 3))], path).psnr.shape == (1,)",
    "pictures as tensors in a list": "splatwire.evaluate(scene, [Tensor(picture[0])], cameras).psnr.min() > 60",
    "pictures of half precision": "splatwire.evaluate(scene, picture.astype(np.float16), cameras).psnr.min() > 60",
}
FAILS = {
    **{
        f"{call}({before}{wrong})": r"expected the path of a"
        for call, before in (
            ("splatwire.open_scene", ""),
            ("splatwire.read_stream", ""),
            ("splatwire.import_hacpp", ""),
            ("splatwire.save_scene", "scene, "),
            ("splatwire.write_stream", "stream, "),
            ("save_cameras", "cameras, "),
            ("load_cameras", ""),
            ("open_dataset", ""),
            ("read_content", ""),
            ("write_splats", "[splats], "),
        )
        for wrong in (
            "None",
            "3",
            "b'scene.ply'",
            "['scene.ply']",
            "1.5",
            "True",
            "''",
            "'a\\0b'",
            "open",
            "splats.means",
        )
    },
    **{
        f"{call}, {folder!r} + {name!r})": r"no such folder, so .* make it first"
        for call, name in (
            ("splatwire.save_scene(scene", ".ply"),
            ("splatwire.save_scene(scene", ".spz"),
            ("splatwire.write_stream(stream", ".swz"),
            ("splatwire.write_stream(stream", ""),
            ("save_cameras(cameras", ".json"),
            ("write_splats([splats]", ".sog"),
        )
        for folder in ("none/a", "x/y/z/a")
    },
    **{
        f"splatwire.transmit(stream, 'bernoulli:0.2', seed={seed})": r"seed must be a whole number of 0 or more, not"
        for seed in ("'a'", "-1", "1.5", "True", "None", "[1]", "np.float32(1)", "2j")
    },
    "open_dataset('.', max_width='wide')": r"max_width must be positive, not wide",
    "draw('scene.ply')": r"expected a scene \(`open_scene` reads one",
    "draw(stream)": r"expected a scene \(`decode_stream` decodes",
    "draw(None)": r"expected a scene .*not NoneType",
    "draw(splatwire.decode_stream(stream.with_packets(())))": r"300 of 300 Gaussians were lost: `splatwire.concealment",
    "draw(Gaussians(splats.means, splats.quats, splats.scales, splats.opacities, splats.scales))": r"create_renderer",
    "draw(splats.means)": r"expected a scene .*not ndarray",
    "draw(cameras=viewmat)": r"expected Cameras \(`splatwire.data.load_cameras` reads one from a file\), not ndarray",
    "draw(cameras=None)": r"expected Cameras",
    "draw(cameras=[cameras])": r"expected Cameras .*not list",
    "draw(cameras='nowhere.json')": r"nowhere.json",
    "draw(renderer=3)": r"expected a renderer or its name",
    "draw(renderer=None)": r"expected a renderer or its name",
    "draw(renderer='vulkan')": r"vulkan",
    "draw(background='white')": r"a background is three numbers",
    "draw(background=(255, 255, 255))": r"a background is three numbers from 0 to 1, not \(255, 255, 255\)",
    **dict.fromkeys(
        (
            "draw(clip)",
            "draw(clip.scene)",
            "splatwire.evaluate(clip, scene, cameras)",
            "splatwire.encode(clip)",
            "splatwire.save_scene(clip, 'x.ply')",
            "conceal(clip, 'grow')",
            "conceal(clip, 'scene_free')",
            "conceal(clip, 'motion')",
        ),
        r"expected a scene \(`splatwire.sequence.decode_frames` conceals a clip",
    ),
    "module('sequence').decode_frame(clip, 0)": r"SequenceScene \(`decode_stream\(...\).scene` is one\), not Received",
    "splatwire.write_stream(stream, 'a.ply')": r"a file of Gaussians, which `save_scene` writes",
    "draw(background=np.ones(4, np.float32))": r"a background is three numbers .*, not \(1.0, 1.0, 1.0, 1.0\)",
    "splatwire.transmit(stream, 0.2, seed=0)": r"expected a loss such as 'bernoulli:0.2'.*not 0.2",
    "splatwire.transmit(stream, None, seed=0)": r"expected a loss such as",
    "splatwire.transmit(scene, 'none', seed=0)": r"expected SceneStream .*not SplatScene",
    "splatwire.parse_loss(0.2)": r"expected the text of a loss model",
    "splatwire.decode_stream(splatwire.read_stream(path.parent / 'x.swz'))": r"take its first item",
    **{
        f"{call}, threads={threads})": r"threads must be a whole number of 0 or more, not"
        for call in ("splatwire.encode_scene(scene", "splatwire.decode_stream(stream")
        for threads in ("'two'", "-1", "1.5", "True")
    },
    **{
        f"{call}, progress={progress})": r"progress must be a function"
        for call in ("splatwire.encode_scene(scene", "splatwire.decode_stream(stream", "draw(scene")
        for progress in ("True", "3", "'bar'")
    },
    "splatwire.decode_stream(scene)": r"expected SceneStream .*not SplatScene",
    "splatwire.write_stream(scene, 'x')": r"expected SceneStream .*not SplatScene",
    "splatwire.encode_scene(scene, 3)": r"expected a Packetization or the name of a preset, not 3",
    "splatwire.encode_scene(scene, 'tiny')": r"tiny",
    "splatwire.encode_scene(stream)": r"decode_stream",
    "splatwire.encode_scene(splats.means)": r"expected a scene",
    "splatwire.save_scene(stream, 'x.ply')": r"decode_stream",
    "splatwire.save_scene('x.ply', scene)": r"expected a scene",
    "splatwire.create_concealer(None)": r"expected the name of a concealer",
    "conceal(scene, 'drop')": r"expected ReceivedScene .*not SplatScene",
    "SplatScene(splats, (1.0, 1.0, 1.0))": r"hints are RenderHints.*background=",
    "SplatScene(splats.means)": r"expected Splats .*not ndarray",
    "SplatScene(scene)": r"expected Splats .*not SplatScene",
    "SplatScene(splats, background=(2, 0, 0))": r"a background is three numbers from 0 to 1, not \(2, 0, 0\)",
    "SplatScene(splats, background=np.ones((3, 1)))": r"a background is three numbers from 0 to 1, not",
    **{
        f"module({name!r}).{call}": message
        for name, call, message in (
            ("rate_control", "encode_controlled('x', None, print)", r"scene: expected SplatScene .*, not str"),
            ("render.pruning", "prune('scene.ply', 0.3)", r"expected a scene \(`open_scene` reads one"),
            ("render.pruning", "prune(scene, '30%')", r"share: expected a number, not '30%'"),
            (
                "evaluation.rate_distortion",
                "bd_rate([(9, 30.0)], [(8, 31.0)])",
                r"reference: .* RatePoint, not list of t",
            ),
            ("evaluation.rate_distortion", "bd_quality(None, [])", r"reference: .* RatePoint, not None"),
            ("rate_control", "parse_size(None)", r"text: expected text, not None"),
            ("finetuning.tune", "fine_tune(None, None)", r"scene: expected SplatScene .*, not None"),
            ("anchors.scene_file", "load_scene(None)", r"path: expected the path of a file or folder, not None"),
            ("concealment.temporal.concealers", "temporal_concealer(None)", r"name: expected text, not None"),
            ("transport.http.pack", "pack_streams([stream])", r"streams: expected a dictionary .*not list of SceneStr"),
        )
    },
    "study.load_study(None)": r"path: expected the path of a file or folder, not None",
    "study.run_study('p.toml', store, study.InProcess(), print)": r"study: expected Study, not 'p.toml'",
    "study.run_study(protocol, 'store', study.InProcess(), print)": r"store: expected Store, not 'store'",
    "study.run_study(protocol, store, 'local', print)": r"engine: expected an Engine, not 'local'",
    "study.run_study(protocol, store, study.InProcess(), None)": r"progress: expected a function, not None",
    "study.SceneEntry('a', 'x.swz', 'splats')": r"unknown kind of scene 'splats': known are model, scene, stream",
    "study.SceneEntry('a', 'x.swz', 'stream', background=(2, 0, 0))": r"a background is three numbers from 0 to 1",
    "conceal(stream, 'drop')": r"expected ReceivedScene \(`decode_stream` returns one\), not SceneStream",
    "splatwire.encode([splats, splats])": r"expected a scene, not list: frames need the options `SequenceOptions`",
    "splatwire.encode([scene], splatwire.SequenceOptions())": r"not list of SplatScene$",
    "draw(renderer=lambda *given, **named: None)": r"the result of the renderer: expected an array \(1, 24, 32, 3\)",
    "splatwire.evaluate(scene, 'x.ply', cameras)": r"expected a scene \(`open_scene` reads one from a file\), not str",
    "splatwire.evaluate(scene, 2 * picture - 1, cameras)": r"expected RGB from 0 to 1, not from -1",
    "SplatScene(splats, background='white')": r"a background is three numbers",
    "Splats(splats.means, splats.quats, splats.scales, splats.opacities[:, None], splats.sh)": (
        r"Splats.opacities: expected a float32 array \(G,\), not float32 \(300, 1\)"
    ),
    "Splats(splats.means, splats.quats[:9], splats.scales, splats.opacities, splats.sh)": (
        r"Splats.quats: .*not float32 \(9, 4\) \(G = 300\)"
    ),
    "Splats(splats.means, splats.quats, splats.scales, splats.opacities, splats.sh[:, 0])": r"\(G, D, 3\), not float32",
    "Splats(*list(vars(splats).values())[:4], splats.sh.astype(np.int32))": r"not int32 \(300, 1, 3\)",
    "Splats([[0, 0, 0]], splats.quats, splats.scales, splats.opacities, splats.sh)": r"not builtins.list",
    "Splats(splats.means, splats.quats, splats.scales, splats.opacities, r(300, 2, 3))": r".",
    "Cameras(viewmat.tolist(), cameras.Ks, 32, 24, ('a',))": r"Cameras.viewmats: .*not builtins.list",
    "Cameras(viewmat[0], cameras.Ks, 32, 24, ('a',))": r"Cameras.viewmats: expected a float32 array \(C, 4, 4\)",
    **{
        f"Cameras(viewmat, cameras.Ks, {size}, 24, ('a',))": r"Cameras.width must be a whole number of 1 or more, not"
        for size in ("'32'", "32.5", "None", "0", "-3", "True")
    },
    "Cameras(viewmat, np.float32([[[30, 1, 16], [0, 30, 12], [0, 0, 1]]]), 32, 24, ('a',))": (
        r"Cameras.Ks: matrix 0 is not \[fx 0 cx; 0 fy cy; 0 0 1\], in pixels"
    ),
    "Cameras(viewmat, cameras.Ks, 32, 24, ('a', 'b'))": r"2 names for 1 cameras",
    **{
        f"Cameras(viewmat, cameras.Ks, 32, 24, {names})": r"Cameras.names: expected a tuple of text, not"
        for names in ("5", "None", "'a'", "(name for name in 'a')", "[1]")
    },
    **{
        f"Cameras({wrong}, cameras.Ks, 32, 24, ('a',))": r"Cameras.viewmats: matrix 0 is not \[R t; 0 0 0 1\]"
        for wrong in ("viewmat.transpose(0, 2, 1)", "2 * viewmat", "viewmat * np.float32([-1, 1, 1, 1])", "0 * viewmat")
    },
    "Cameras(viewmat * np.nan, cameras.Ks, 32, 24, ('a',))": r"Cameras.viewmats: matrix 0 .* not finite",
    "Cameras(viewmat, cameras.Ks * np.inf, 32, 24, ('a',))": r"Cameras.Ks: matrix 0 .* not finite",
    "cameras['a']": r"the index of a camera must be a whole number",
    **{
        f"draw(background={color})": r"a background is three numbers from 0 to 1"
        for color in ("(np.nan, 0, 0)", "[-1, 0, 0]", "np.full(3, 1e9)", "[[0, 1], 2]")
    },
    "draw(renderer={'name': 'cpu'})": r"expected a renderer or its name such as 'cpu', not dict",
    **{
        f"splatwire.encode_scene(scene, tiers={tiers})": r"tiers: expected an array \(300,\) of whole numbers from 0"
        for tiers in ("np.full(n, -1)", "np.full(n, np.nan)", "[[0], [0, 1]]", "[0, 1]", "np.full(n, 8)", "[None] * n")
    },
    **{
        f"splatwire.encode_scene(scene, class_offsets={classes})": r"class_offsets: expected an array \(300,\) of whole"
        for classes in ("np.full(n, np.nan)", "np.full(n, 10**9)", "[0.5] * n", "3 * [1]")
    },
    **{
        f"splatwire.encode_scene(scene, quality={quality})": r"quality: expected 'small', 'default', 'near-lossless'"
        for quality in ("[1, 2]", "True", "{}", "splats")
    },
    "splatwire.encode_scene(scene, threads=10**30)": r"threads must be a whole number of at most 1024",
    "splatwire.SceneStream(stream.manifest, b'', None)": r"SceneStream.packets: expected a tuple of Packet",
    "splatwire.SceneStream({}, stream.side_info, ())": r"SceneStream.manifest: expected Manifest",
    "splatwire.SceneStream(stream.manifest, None, ())": r"SceneStream.side_info: expected bytes",
    "splatwire.ReceivedScene(None, None)": r"ReceivedScene.loss_mask: expected LossMask, not None",
    "splatwire.ReceivedScene(None, received.loss_mask)": r"ReceivedScene.scene: expected a scene",
    "splatwire.ReceivedScene(scene, received.loss_mask, {1: 2})": (
        r"ReceivedScene.sections: expected a dictionary of bytes by text"
    ),
    "SplatScene(splats, metadata='x')": r"SplatScene.metadata: expected SceneMetadata",
    **{
        f"write_splats({parts}, path.parent / 'z.ply')": r"expected (a sequence of )?Splats"
        for parts in ("splats", "None", "stream", "[3]", "iter([3])")
    },
    "Anchors(r(5, 3), r(5, 8), r(5, 6), r(5, 2, 3), r(5, 2))": r"Anchors.mask: expected a bool array \(N, K\)",
}


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory) -> dict[str, tuple[str, str]]:
    """Result of each call: value, or kind of error and its message."""
    body = f"""
{PRELUDE}
found = {{}}
for text in {[*WORKS.values(), *FAILS]!r}:
    try:
        found[text] = ["", repr(eval(text))]
    except splatwire.SplatwireError as error:
        found[text] = ["SplatwireError", str(error)]
    except Exception as error:
        found[text] = [type(error).__name__, str(error)]
print(json.dumps(found))
"""
    folder = tmp_path_factory.mktemp("arguments")
    command = [sys.executable, "-c", body, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("what", WORKS)
def test_valid_arguments_are_accepted(outcomes, what):
    kind, value = outcomes[WORKS[what]]
    assert (kind, value) in (("", "True"), ("", "np.True_"))


@pytest.mark.parametrize("call", FAILS)
def test_invalid_argument_is_one_error_naming_valid_ones(outcomes, call):
    if "import_hacpp" in call:
        pytest.importorskip("torch")
    kind, message = outcomes[call]
    assert kind == "SplatwireError", f"{kind}: {message}"
    assert re.search(FAILS[call], message), message


def records() -> list[type]:
    """Objects of the data model with arrays or bytes."""
    found = []
    for package in (splatwire.types, splatwire.anchors, splatwire.bitstream):
        for module in pkgutil.iter_modules(package.__path__):
            for value in vars(importlib.import_module(f"{package.__name__}.{module.name}")).values():
                if dataclasses.is_dataclass(value) and value.__module__.startswith(package.__name__):
                    hints = " ".join(str(hint) for hint in typing.get_type_hints(value).values())
                    if re.search(r"Tensor|ndarray|\bbytes\b|jaxtyping|Splats", hints):
                        found.append(value)
    return sorted(set(found), key=lambda kind: kind.__qualname__)


@pytest.mark.parametrize("kind", records(), ids=lambda kind: kind.__qualname__)
@pytest.mark.needs_torch
def test_repr_shows_types_and_shapes_without_values(kind):
    fields = {f.name: np.zeros((1000, 3), np.float32) for f in dataclasses.fields(kind)}
    record = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(record, name, value)
    text = repr(record)
    assert text.startswith(f"{kind.__name__}(")
    assert "float32 (1000, 3)" in text
    assert "array(" not in text


def test_repr_shows_long_values_by_length():
    from splatwire.reprs import summarize

    assert summarize(b"x" * 5000) == "5,000 bytes"
    assert summarize(tuple(range(100))) == "tuple of 100"
    assert summarize((np.zeros(2, np.float32), 1)) == "(float32 (2,), 1)"
    assert summarize({"a": b"12"}) == "{'a': 2 bytes}"
    assert len(summarize("x" * 1000)) < 100
