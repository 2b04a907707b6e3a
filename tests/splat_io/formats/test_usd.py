"""OpenUSD scenes, checked by usd-core itself."""

import random
import re
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdValidation, UsdVol, Vt

from splatwire.errors import DatasetError
from splatwire.io.formats import _usd_process, read_content, read_splats, write_splats
from splatwire.io.formats._columns import concatenate
from splatwire.io.formats._usd_limits import Limits
from splatwire.io.formats._usd_process import SCENE
from splatwire.io.formats._usd_stage import PRIM
from splatwire.io.formats._usd_worker import read_messages
from splatwire.io.formats.content import FileContent
from splatwire.io.formats.usd import usd_frames, write_usd_frames
from splatwire.types.metadata import SceneMetadata, StartView

from .handmade import some_splats

FIELDS = ("means", "quats", "scales", "opacities", "sh")
SUFFIXES = ("usd", "usda", "usdc", "usdz")


def assert_same(found, expected, tolerance=1e-7):
    for name in FIELDS:
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0, atol=tolerance, err_msg=name)


def read_here(path):
    """Reads a scene in this process, without limits, so that a test can observe or change how."""
    ((_, content),) = read_messages(SCENE, path, Limits(are_set=False))
    return content.splats


@pytest.mark.parametrize(
    ("suffix", "up"),
    [
        *((suffix, None) for suffix in SUFFIXES),
        *(("usdc", up) for up in ("-y", "y", "z")),
        ("usda", "z"),
        ("usdz", "y"),
    ],
)
def test_written_scenes_are_read_unchanged(tmp_path, suffix, up):
    splats = some_splats(degree=3)
    view = StartView((0.0, 1.0, -4.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0))
    metadata = SceneMetadata(title="a room", author="Jane", license="CC-BY-4.0", up=up, view=view)
    write_splats([splats], tmp_path / f"a.{suffix}", metadata=metadata)
    found = read_content(tmp_path / f"a.{suffix}")
    assert_same(found.splats, splats)
    assert found.metadata == metadata


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_usd_core_sees_a_valid_prim_of_its_schema(tmp_path, degree):
    write_splats([some_splats(degree=degree)], tmp_path / "a.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/Scene/Gaussians"))
    assert prim
    assert len(prim.GetPositionsAttr().Get()) == 20
    assert len(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get()) == 20 * (degree + 1) ** 2
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    assert [str(error.GetMessage()) for error in context.Validate(stage)] == []


def test_a_scene_is_upright_in_a_stage_with_y_up(tmp_path):
    """Axes of a PLY are right, down, forward; y up and the camera's view along -z are right, up, back."""
    splats = some_splats(degree=0)
    write_splats([splats], tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    positions = np.array(stage.GetPrimAtPath("/Scene/Gaussians").GetAttribute("positions").Get())
    np.testing.assert_array_equal(positions, splats.means * np.float32([1, -1, -1]))


def test_an_origin_is_a_translation_in_double_precision(tmp_path):
    origin = (500_000.25, 4_500_000.5, 120.0)
    write_splats([some_splats()], tmp_path / "a.usdc", origin=origin)
    found = read_content(tmp_path / "a.usdc")
    step = np.abs(np.array(found.origin) - origin).max()
    np.testing.assert_allclose(found.splats.means + (np.array(found.origin) - origin), some_splats().means, atol=1e-5)
    assert step < 1000


def foreign(path, splats, *, up="Z", half=False, matrix=None, harmonics=True, count=None):
    """Writes a file as another program may write it."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/World/Cloud")
    if matrix is not None:
        UsdGeom.Xformable(prim).AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
    vectors = Vt.Vec3hArray.FromNumpy if half else Vt.Vec3fArray.FromNumpy
    (prim.CreatePositionshAttr if half else prim.CreatePositionsAttr)(vectors(cast(splats.means, half)))
    (prim.CreateScaleshAttr if half else prim.CreateScalesAttr)(vectors(cast(splats.scales, half)))
    prim.CreateOrientationsAttr(Vt.QuatfArray([Gf.Quatf(*map(float, quat)) for quat in splats.quats]))
    prim.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(np.array(splats.opacities)))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(splats.degree)
    if harmonics:
        values = cast(splats.sh.reshape(-1, 3)[:count], half)
        name = f"CreateRadianceSphericalHarmonicsCoefficients{'h' * half}Attr"
        getattr(prim, name)(vectors(values))
    stage.Save()
    return path


def cast(values, half):
    return np.ascontiguousarray(values, np.float16 if half else np.float32)


def test_files_of_other_programs_keep_their_axes_where_z_is_up(tmp_path):
    splats = some_splats()
    found = read_content(foreign(tmp_path / "a.usda", splats))
    assert_same(found.splats, splats, 1e-6)
    assert found.metadata.up == "z"


def test_numbers_of_type_half_are_read(tmp_path):
    assert_same(read_splats(foreign(tmp_path / "a.usdc", some_splats(), half=True)), some_splats(), 4e-3)


def test_harmonics_of_degree_4_are_cut_with_a_warning(tmp_path, caplog):
    splats = some_splats()
    path = foreign(tmp_path / "a.usda", splats, harmonics=False)
    stage = Usd.Stage.Open(str(path))
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/World/Cloud"))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(4)
    more = np.zeros((splats.num_gaussians, 25 - splats.sh.shape[1], 3), np.float32)
    values = np.concatenate([splats.sh, more], axis=1).reshape(-1, 3)
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(cast(values, False)))
    stage.Save()
    found = read_splats(path)
    assert found.degree == 3
    np.testing.assert_array_equal(found.sh[:, : splats.sh.shape[1]], splats.sh)
    assert "harmonics of degree 4 are read up to degree 3" in caplog.text


def test_transforms_of_prims_are_applied(tmp_path):
    splats = some_splats(degree=0)
    matrix = np.eye(4)
    matrix[:3, :3] = 2 * np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    matrix[:3, 3] = 1, 2, 3
    found = read_splats(foreign(tmp_path / "a.usda", splats, matrix=matrix))
    np.testing.assert_allclose(found.means, splats.means @ matrix[:3, :3].T + [1, 2, 3], atol=1e-5)
    np.testing.assert_allclose(found.scales, 2 * splats.scales, rtol=1e-5)


def test_invisible_prims_are_left_out(tmp_path):
    foreign(tmp_path / "a.usda", some_splats())
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    UsdGeom.Imageable(stage.GetPrimAtPath("/World/Cloud")).MakeInvisible()
    stage.Save()
    with pytest.raises(DatasetError, match="no visible prim"):
        read_splats(tmp_path / "a.usda")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PXR-USDC" + bytes(200), "usd-core cannot open it"),
        (b"#usda 1.0\nbroken {", "usd-core cannot open it"),
        (b'#usda 1.0\ndef "\xff\xad" (', "usd-core cannot open it"),
        (b'#usda 1.0\ndef Xform "a" {}\n', "no visible prim of the type"),
        (
            b'#usda 1.0\ndef ParticleField3DGaussianSplat "a" {\n point3f[] positions = [(0, 0, 0)]\n}\n',
            "has no orientations",
        ),
    ],
)
def test_damaged_and_incomplete_files_are_one_error(tmp_path, content, message):
    (tmp_path / "a.usd").write_bytes(content)
    with pytest.raises(DatasetError, match=message):
        read_splats(tmp_path / "a.usd")


def test_errors_of_usd_core_after_opening_are_one_error(tmp_path, monkeypatch):
    """As for the empty name of an attribute in a damaged file; only this function requests it."""

    def damaged(prim):
        Tf.RaiseRuntimeError("the property has no name")

    write_splats([some_splats()], tmp_path / "a.usdc")
    monkeypatch.setattr("splatwire.io.formats._usd_stage._unknown_attributes", damaged)
    with pytest.raises(DatasetError, match="usd-core cannot read it"):
        read_here(tmp_path / "a.usdc")


def changed_byte(tmp_path, from_end, value):
    """A scene with one changed byte."""
    write_splats([some_splats(degree=1)], tmp_path / "a.usdc")
    content = bytearray((tmp_path / "a.usdc").read_bytes())
    content[-from_end] = value
    (tmp_path / "a.usdc").write_bytes(content)
    return tmp_path / "a.usdc"


def test_a_damaged_size_takes_little_memory(tmp_path):
    pytest.importorskip("resource", reason="limits of memory are those of Unix")
    with pytest.raises(DatasetError, match=r"a\.usdc: usd-core cannot read it: it needs more than 1\.1 GB of memory"):
        read_splats(changed_byte(tmp_path, 345, 128))


@pytest.mark.extended
@pytest.mark.slow
def test_a_changed_byte_is_one_error_or_none(tmp_path):
    generator = random.Random(7)
    for _ in range(12):
        path = changed_byte(tmp_path, generator.randrange(1, 1500), generator.choice([0, 1, 127, 128, 255]))
        with suppress(DatasetError):
            read_splats(path)


LIMITED = """
import time
from splatwire.io.formats import _usd_limits
_usd_limits._FREE_SECONDS = 0.1
limits = _usd_limits.Limits(are_set=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "message"),
    [
        ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)", "its process was ended by SIGSEGV"),
        (f"{LIMITED}limits.pause()\nwhile True:\n    pass", "it takes too much time for its size"),
        (f"{LIMITED}time.sleep(600)", "it takes too much time for its size"),
        ("raise ImportError('gone')", "its process ended with status 1: ImportError: gone"),
        ("print('{\"content\": ', end='')", "its process ended with status 0"),
    ],
)
@pytest.mark.parametrize("read", [read_splats, usd_frames])
def test_the_end_of_the_reading_process_is_one_error(tmp_path, monkeypatch, work, message, read):
    pytest.importorskip("resource", reason="signals and limits of processor time are those of Unix")
    (tmp_path / "usd_worker_for_tests.py").write_text(work)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("splatwire.io.formats._usd_process._WORKER", "usd_worker_for_tests")
    write_splats([some_splats()], tmp_path / "a.usdc")
    with pytest.raises(DatasetError, match=rf"a\.usdc: usd-core cannot read it: {message}"):
        read(tmp_path / "a.usdc")


def test_limits_grow_with_files_and_gaussians(tmp_path):
    limits = Limits(are_set=False)
    start = limits.memory
    write_splats([some_splats()], tmp_path / "a.usdc")
    for _ in range(2):
        limits.add_file(tmp_path / "a.usdc")  # counted once
    binary = limits.memory - start
    assert binary == 24 * (tmp_path / "a.usdc").stat().st_size
    (tmp_path / "a.usda").write_text("#usda 1.0")
    limits.add_file(tmp_path / "a.usda")
    assert limits.memory - start - binary == 120 * 9
    assert limits.file_bytes == (tmp_path / "a.usdc").stat().st_size + 9
    limits.add_gaussians(1000)
    assert limits.memory - start - binary == 120 * 9 + 24 * 1000
    limits.restart()
    limits.add_gaussians(500)  # of the next frame, which is smaller
    assert limits.memory - start - binary == 120 * 9 + 24 * 1000


def test_frames_that_are_left_early_end_their_process(tmp_path, monkeypatch):
    started, popen = [], _usd_process.subprocess.Popen
    monkeypatch.setattr(
        _usd_process.subprocess, "Popen", lambda *words, **more: started.append(popen(*words, **more)) or started[-1]
    )
    write_usd_frames((FileContent(some_splats()) for _ in range(3)), tmp_path / "a.usdc", 24.0)
    frames = usd_frames(tmp_path / "a.usdc").read()
    next(frames)
    frames.close()
    assert [process.returncode is None for process in started] == [False, False]


def test_a_clip_that_was_changed_meanwhile_is_refused(tmp_path):
    path = tmp_path / "a.usdc"
    write_usd_frames((FileContent(some_splats()) for _ in range(3)), path, 24.0)
    found = usd_frames(path)
    write_usd_frames((FileContent(some_splats()) for _ in range(2)), path, 24.0)
    with pytest.raises(DatasetError, match="was changed while it was read"):
        next(found.read())


def test_harmonics_that_contradict_their_degree_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="which have 16 each"):
        read_splats(foreign(tmp_path / "a.usda", some_splats(), count=-1))
    with pytest.raises(DatasetError, match="has no radiance:sphericalHarmonicsCoefficients"):
        read_splats(foreign(tmp_path / "b.usda", some_splats(), harmonics=False))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_frames_are_time_samples(tmp_path, suffix):
    first = some_splats(degree=1)
    frames = [
        FileContent(replace(first, means=first.means + np.float32([0.1 * t, 0, 0])).slice_range(0, 20 - t))
        for t in range(3)
    ]
    path = tmp_path / f"a.{suffix}"
    assert write_usd_frames(iter(frames), path, 24.0) == 3
    stage = Usd.Stage.Open(str(path))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 2, 24)
    assert stage.GetPrimAtPath("/Scene/Gaussians").GetAttribute("positions").GetTimeSamples() == [0, 1, 2]
    found = usd_frames(path)
    assert found.rate == 24
    for frame, expected in zip(found.read(), frames, strict=True):
        assert_same(frame.splats, expected.splats)
    assert_same(read_splats(path), first)


def test_a_still_scene_has_no_frames(tmp_path):
    write_splats([some_splats()], tmp_path / "a.usdc")
    assert usd_frames(tmp_path / "a.usdc") is None


def test_hostile_times_and_metadata_are_one_error_or_ignored(tmp_path):
    path = foreign(tmp_path / "a.usda", some_splats())
    stage = Usd.Stage.Open(str(path))
    stage.GetRootLayer().customLayerData = {"splatwire": "[" * 100_000}
    stage.GetRootLayer().Save()
    assert_same(read_splats(path), some_splats())
    positions = stage.GetPrimAtPath("/World/Cloud").GetAttribute("positions")
    for time in (0.0, 5e-324):
        positions.Set(positions.Get(), Usd.TimeCode(time))
    stage.GetRootLayer().Save()
    with pytest.raises(DatasetError, match="2 frames at inf per second are out of range"):
        usd_frames(path)


def test_prims_that_are_referred_to_many_times_are_counted_before_all_are_read(tmp_path, monkeypatch):
    stage = Usd.Stage.Open(str(foreign(tmp_path / "a.usdc", some_splats())))
    for number in range(400):
        stage.DefinePrim(f"/Many/c{number}").GetReferences().AddInternalReference("/World/Cloud")
    stage.GetRootLayer().Save()
    monkeypatch.setattr("splatwire.io.formats._columns.FREE_GAUSSIANS", 100)
    assert (tmp_path / "a.usdc").stat().st_size // 4 < 8000
    with pytest.raises(DatasetError, match="is more than") as raised:
        read_here(tmp_path / "a.usdc")
    assert int(re.search(r"a count of (\d+)", str(raised.value))[1]) < 20 * 401


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz"])
def test_a_file_that_cannot_be_written_is_one_error_and_leaves_nothing(tmp_path, suffix):
    resource = pytest.importorskip("resource", reason="limits of the file size are those of Unix")
    (tmp_path / "out").mkdir()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    splats = concatenate([some_splats(degree=3)] * 100)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
        with pytest.raises(DatasetError, match="usd-core cannot write it"):
            write_splats([splats], tmp_path / "out" / f"a.{suffix}")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list((tmp_path / "out").iterdir())


CLIPS = """(
    clips = {
        dictionary default = {
            %s
            string primPath = "/Scene/Gaussians"
            double2[] active = [(0, 0)]
            double2[] times = [(0, 0)]
        }
    }
    references = @./own.usda@</Scene>
)
{
}"""
PARTS = {
    "reference": "(references = @%s@</Scene>) {}",
    "payload": "(payload = @%s@</Scene>) {}",
    "variant": """(
    variants = {
        string v = "a"
    }
    prepend variantSets = "v"
)
{
    variantSet "v" = {
        "a" (payload = @%s@</Scene>) {
        }
    }
}""",
    "clip": CLIPS % "asset[] assetPaths = [@%s@]",
    "clips by a pattern": CLIPS % 'string templateAssetPath = "%s"',
    "clip in a variant": """(
    references = @./own.usda@</Scene>
    variants = {
        string v = "a"
    }
    prepend variantSets = "v"
)
{
    variantSet "v" = {
        "a" (
            clips = {
                dictionary default = {
                    asset[] assetPaths = [@%s@]
                    string primPath = "/Scene/Gaussians"
                    double2[] active = [(0, 0)]
                    double2[] times = [(0, 0)]
                }
            }
        ) {
        }
    }
}""",
}
"""References from a prim to another file."""


def composed(path, part, name):
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'#usda 1.0\ndef Xform "A" {PARTS[part] % name}\n')
    return path


@pytest.fixture
def around(tmp_path):
    """Folder with a scene and a subfolder, which contains another scene."""
    for path in (tmp_path / "other.usda", tmp_path / "here" / "own.usda"):
        path.parent.mkdir(exist_ok=True)
        write_splats([some_splats()], path)
    (tmp_path / "here" / "link.usda").symlink_to(tmp_path / "other.usda")
    return tmp_path / "here"


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("name", ["../other.usda", "./link.usda", "/etc/other.usda", "../gone.usda"])
def test_files_outside_of_the_folder_are_refused_and_not_opened(around, part, name, monkeypatch):
    opened = []
    monkeypatch.setattr(Usd.Stage, "Open", lambda path: opened.append(path))
    with pytest.raises(DatasetError, match="outside of its folder"):
        read_here(composed(around / "a.usda", part, name))
    (around / "a.usda").write_text('#usda 1.0\ndef Xform "B" (references = @./deep/b.usda@</A>) {}\n')
    composed(around / "deep" / "b.usda", part, f"../{name}" if name[0] == "." else name)
    with pytest.raises(DatasetError, match="outside of its folder"):
        read_here(around / "a.usda")
    assert not opened


def test_sublayers_outside_of_the_folder_and_expressions_are_refused(around):
    path = around / "a.usda"
    path.write_text("#usda 1.0\n(\n    subLayers = [@../other.usda@]\n)\n")
    with pytest.raises(DatasetError, match="outside of its folder"):
        read_splats(path)  # in a separate process, as users read
    text = '#usda 1.0\n(\n    expressionVariables = {\n        string P = "../other.usda"\n    }\n)\n'
    path.write_text(text + 'def Xform "A" (references = @`"${P}"`@</Scene>) {}\n')
    with pytest.raises(DatasetError, match="by the expression"):
        read_here(path)


@pytest.mark.parametrize("part", PARTS)
def test_files_in_the_folder_are_composed(around, part):
    assert read_here(composed(around / "a.usda", part, "./own.usda")).num_gaussians == 20


def test_archives_in_the_folder_are_composed(around):
    write_splats([some_splats()], around / "own.usdz")
    assert read_splats(composed(around / "a.usda", "reference", "./own.usdz")).num_gaussians == 20


@pytest.mark.parametrize("part", ["reference", "payload"])
def test_the_number_of_gaussians_is_compared_with_all_files_of_a_scene(around, part, monkeypatch):
    monkeypatch.setattr("splatwire.io.formats._columns.FREE_GAUSSIANS", 0)
    monkeypatch.setattr("splatwire.io.formats._columns.BYTES_PER_GAUSSIAN", 100)
    path = composed(around / "a.usda", part, "./own.usda")
    assert path.stat().st_size < 20 * 100 < (around / "own.usda").stat().st_size
    assert read_here(path).num_gaussians == 20


@pytest.mark.parametrize(
    ("part", "name"),
    [("reference", "./link.usda:SDF_FORMAT_ARGS:a=b"), ("clips by a pattern", "./frame.#.usda")],
)
def test_links_out_of_the_folder_are_found_behind_arguments_and_in_patterns(around, part, name):
    (around / "frame.100.usda").symlink_to(around.parent / "other.usda")
    with pytest.raises(DatasetError, match="outside of its folder"):
        read_here(composed(around / "a.usda", part, name))


def test_a_scene_whose_files_are_links_into_one_folder_is_read(tmp_path):
    """The cache of the Hugging Face Hub consists of such links."""
    blobs, scene = tmp_path / "blobs", tmp_path / "snapshots" / "revision"
    (scene / "deep").mkdir(parents=True)
    blobs.mkdir()
    write_splats([some_splats()], tmp_path / "own.usda")
    composed(tmp_path / "a.usda", "reference", "./deep/own.usda")
    for name, link in (("a.usda", scene / "a.usda"), ("own.usda", scene / "deep" / "own.usda")):
        (tmp_path / name).rename(blobs / name[0])
        link.symlink_to(blobs / name[0])
    assert read_here(scene / "a.usda").num_gaussians == 20
    (blobs / "o").rename(tmp_path / "o")
    (scene / "deep" / "own.usda").unlink()
    (scene / "deep" / "own.usda").symlink_to(tmp_path / "o")
    with pytest.raises(DatasetError, match="outside of its folder"):
        read_here(scene / "a.usda")


@pytest.mark.parametrize("name", ["./gone.usda", "gone.usda", "./photo.png"])
def test_a_missing_or_unknown_file_of_a_scene_gives_one_warning(around, name, caplog, capfd):
    (around / "photo.png").write_bytes(b"no scene")
    path = around / "a.usda"
    path.write_text(f"#usda 1.0\n(\n    subLayers = [@{name}@, @./own.usda@]\n)\n")
    assert read_splats(path).num_gaussians == 20
    assert [name in message for message in caplog.messages] == [True]
    assert capfd.readouterr().err == ""  # else usd-core prints its own


def test_other_warnings_of_usd_core_are_logged(around, caplog, capfd):
    path = around / "a.usda"
    path.write_text(
        '#usda 1.0\n(\n    subLayers = [@./own.usda@]\n)\ndef "B" (references = @./own.usda@</no/prim>)\n{\n}\n'
    )
    assert read_splats(path).num_gaussians == 20
    assert ["usd-core: " in message for message in caplog.messages] == [True]
    assert capfd.readouterr().err == ""


def edited(tmp_path, edit, splats=None):
    """A file of another program after a change of its stage."""
    path = foreign(tmp_path / "a.usda", some_splats() if splats is None else splats)
    stage = Usd.Stage.Open(str(path))
    edit(stage, stage.GetPrimAtPath("/World/Cloud"))
    stage.GetRootLayer().Save()
    return path


def test_instances_are_read(tmp_path):
    def repeat(stage, _):
        for number in range(2):
            copy = stage.DefinePrim(f"/Copy{number}", "Xform")
            copy.GetReferences().AddInternalReference("/World")
            copy.SetInstanceable(True)

    assert read_here(edited(tmp_path, repeat)).num_gaussians == 3 * some_splats().num_gaussians


def test_a_point_instancer_of_gaussians_is_refused(tmp_path):
    def repeat(stage, prim):
        instancer = UsdGeom.PointInstancer.Define(stage, "/Many")
        instancer.CreatePrototypesRel().SetTargets([prim.GetPath().GetParentPath()])

    with pytest.raises(DatasetError, match="/Many repeats Gaussians, which is not read"):
        read_here(edited(tmp_path, repeat))


def test_gaussians_that_are_scaled_to_a_plane_are_flat(tmp_path):
    def flatten(_, prim):
        UsdGeom.Xformable(prim).AddScaleOp(opSuffix="flat").Set(Gf.Vec3f(1, 1, 0))

    found = read_here(edited(tmp_path, flatten))
    assert found.num_gaussians == some_splats().num_gaussians
    assert (found.scales.min(axis=1) < 1e-6 * found.scales.max(axis=1)).all()


def test_prims_that_are_scaled_to_nothing_are_left_out(tmp_path, caplog):
    def vanish(_, prim):
        UsdGeom.Xformable(prim).AddScaleOp(opSuffix="none").Set(Gf.Vec3f(0, 0, 0))

    def copied(stage, prim):
        stage.DefinePrim("/Copy", "Xform").GetReferences().AddInternalReference(prim.GetParent().GetPath())
        vanish(stage, prim)
        stage.GetPrimAtPath(f"/Copy/{prim.GetName()}").GetAttribute("xformOp:scale:none").Set(Gf.Vec3f(1, 1, 1))

    assert read_here(edited(tmp_path, copied)).num_gaussians == some_splats().num_gaussians
    assert "1 prims that are scaled to nothing are left out" in caplog.text
    (tmp_path / "a.usda").unlink()
    with pytest.raises(DatasetError, match=r"its 1 prims .* are scaled to nothing"):
        read_here(edited(tmp_path, vanish))


def test_a_transform_that_is_not_finite_is_refused(tmp_path):
    def move(_, prim):
        UsdGeom.Xformable(prim).AddTranslateOp().Set(Gf.Vec3d(float("nan"), 0, 0))

    with pytest.raises(DatasetError, match="not finite"):
        read_here(edited(tmp_path, move))


def test_usd_proxies_and_guides_are_left_out(tmp_path, caplog):
    def add(stage, prim):
        copy = stage.DefinePrim("/World/Proxy")
        copy.GetReferences().AddInternalReference(prim.GetPath())
        UsdGeom.Imageable(copy).CreatePurposeAttr("proxy")

    assert_same(read_here(edited(tmp_path, add)), some_splats(), 1e-6)
    assert "1 prims with the purpose guide or proxy are left out" in caplog.text


def logits(_, prim):
    values = some_splats().opacities
    prim.GetAttribute("opacities").Set(Vt.FloatArray.FromNumpy(np.log(values / (1 - values))))


def linear_colours(_, prim):
    Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr("lin_rec709_scene")


def animated(_, prim):
    shift = UsdGeom.Xformable(prim).AddTranslateOp()
    for time in (0, 10):
        shift.Set(Gf.Vec3d(time, 0, 0), time)


def stretched(_, prim):
    UsdGeom.Xformable(prim).AddScaleOp().Set(Gf.Vec3f(1, 3, 1))


def other_particles(stage, _):
    stage.DefinePrim("/World/Other", "ParticleField")


def projected(_, prim):
    prim.CreateAttribute("projectionModeHint", Sdf.ValueTypeNames.Token).Set("tangential")


def hidden_ids(_, prim):
    prim.CreateAttribute("invisibleIds", Sdf.ValueTypeNames.Int64Array).Set([1, 2])


@pytest.mark.parametrize(
    ("edit", "warning"),
    [
        (projected, "attributes projectionModeHint of Gaussians are not known"),
        (hidden_ids, "attributes invisibleIds of Gaussians are not known"),
        (logits, "so they may be logits"),
        (linear_colours, "its colours are linear (lin_rec709_scene)"),
        (animated, "animations of transforms and visibility are left out"),
        (stretched, "their harmonics only turn"),
        (other_particles, f"1 particle fields that are no {PRIM} are left out"),
    ],
)
def test_what_changes_the_picture_and_is_not_applied_gives_a_warning(tmp_path, caplog, edit, warning):
    read_here(edited(tmp_path, edit))
    assert warning in caplog.text


def test_an_unedited_scene_gives_no_message(tmp_path, caplog):
    read_here(edited(tmp_path, lambda *_: None))
    assert not caplog.messages


def test_attributes_of_any_geometry_give_no_warning(tmp_path, caplog):
    def edit(_, prim):
        gprim = UsdGeom.Gprim(prim)
        gprim.CreateDoubleSidedAttr(True)
        gprim.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
        prim.CreateAttribute("semantics:labels:class", Sdf.ValueTypeNames.TokenArray).Set(["tree"])

    read_splats(edited(tmp_path, edit))
    assert not caplog.messages


def appears(when):
    """Makes a copy of the Gaussians visible at some times only.

    `when` maps each time to a visibility.
    """

    def edit(stage, prim):
        copy = stage.DefinePrim("/World/Later")
        copy.GetReferences().AddInternalReference(prim.GetPath())
        for time, value in when.items():
            UsdGeom.Imageable(copy).CreateVisibilityAttr().Set(value, time)

    return edit


def test_prims_that_appear_later_give_a_warning(tmp_path, caplog):
    path = edited(tmp_path, appears({0: "invisible", 5: "inherited"}))
    assert read_here(path).num_gaussians == some_splats().num_gaussians
    assert "1 prims that are invisible at first and appear later are left out" in caplog.text


def test_a_scene_that_is_invisible_at_first_is_refused_with_the_reason(tmp_path):
    def hide(_, prim):
        for time, value in ((0, "invisible"), (5, "inherited")):
            UsdGeom.Imageable(prim).CreateVisibilityAttr().Set(value, time)

    with pytest.raises(DatasetError, match="prims of the type ParticleField3DGaussianSplat appear later"):
        read_here(edited(tmp_path, hide))


def test_frames_have_the_prims_that_are_visible_then(tmp_path):
    def edit(stage, prim):
        for time in range(3):
            prim.GetAttribute("positions").Set(prim.GetAttribute("positions").Get(), time)
        appears({0: "invisible", 1: "inherited", 2: "invisible"})(stage, prim)

    count = some_splats().num_gaussians
    frames = list(usd_frames(edited(tmp_path, edit)).read())
    assert [frame.splats.num_gaussians for frame in frames] == [count, 2 * count, count]
