"""File formats of installed packages are read, written and refused like built-in ones."""

import csv
import json
import logging

import numpy as np
import pytest

from distributions import install_page, run_with
from splatwire.errors import InvalidValueError, SplatwireError, UnknownNameError
from splatwire.files.kinds import file_kind
from splatwire.files.scene_formats import FORMATS, FileFormat
from splatwire.io import open_scene, save_scene
from splatwire.io.formats import format_for, read_content, register_format, splats_kind, write_splats
from splatwire.types.splats import Splats

HEAD = b"TOY\x01"
PROTOCOL = """
[protocol]
name = "xyz"
title = "xyz"
metrics = ["psnr"]
views = 1
[[scene]]
name = "points"
scene = "points.xyz"
[[loss]]
model = "bernoulli:0.5"
[[row]]
key = "drop"
label = "drop"
block_size = 10
[[row]]
key = "grow"
label = "grow"
conceal = "grow"
block_size = 10
"""


def some_splats(count: int = 50) -> Splats:
    rng = np.random.default_rng(1)
    turns = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    return Splats(
        rng.random((count, 3), np.float32), turns, np.full((count, 3), 0.02, np.float32),
        np.full(count, 0.9, np.float32), rng.random((count, 1, 3), np.float32) - 0.5,
    )  # fmt: skip


@pytest.fixture
def register():
    """Registers formats for one test."""
    kept = FORMATS.registered()
    yield register_format
    for name in set(FORMATS.registered()) - set(kept):
        del FORMATS._entries[name], FORMATS._sources[name]


def toy(**changes):
    parts = {
        "name": "toy", "description": "a toy file", "recognises": lambda head, suffix: head.startswith(HEAD),
        "read": lambda path: some_splats(), "write": lambda parts, path: path.write_bytes(HEAD),
    }  # fmt: skip
    return FileFormat(**{**parts, **changes})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    install_page("your-own-format.md", folder / "site")
    write_splats([some_splats()], folder / "scene.ply")
    rows = np.concatenate([some_splats().means, np.full((50, 3), 100)], axis=1)
    np.savetxt(folder / "points.xyz", rows, "%.7g", header="xyz rgb")
    return folder


def run(folder, *words):
    done = run_with(folder / "site", folder, *words)
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.slow
def test_format_of_the_page_works_from_file_to_file(folder):
    content = json.loads(run(folder, "inspect", "points.xyz", "--json").stdout)
    assert content["kind"] == "explicit Gaussians (xyz)"
    assert content["num_rows"] == 50
    assert json.loads(run(folder, "encode", "points.xyz", "-o", "points.swz", "--json").stdout)["num_elements"] == 50
    run(folder, "decode", "points.swz", "-o", "decoded.xyz")
    run(folder, "export", "xyz", "scene.ply", "-o", "scene.xyz")
    for name in ("decoded.xyz", "scene.xyz"):
        rows = np.loadtxt(folder / name)
        assert rows.shape == (50, 6)
    before, after = np.loadtxt(folder / "points.xyz"), np.loadtxt(folder / "decoded.xyz")
    apart = np.linalg.norm(before[:, None, :3] - after[None, :, :3], axis=2)
    assert float(apart.min(axis=1).max()) < 0.01


@pytest.mark.slow
def test_study_and_its_workers_read_files_of_the_format(folder):
    (folder / "study.toml").write_text(PROTOCOL, encoding="utf-8")
    run(folder, "study", "study.toml", "-o", "out", "--engine", "local", "--workers", "1")
    with (folder / "out" / "records.csv").open() as file:
        records = {record["conceal"]: record for record in csv.DictReader(file)}
    assert set(records) == {"drop", "grow"}
    assert all(float(record["psnr"]) > 0 for record in records.values())


@pytest.mark.slow
def test_damaged_file_of_the_format_is_one_line(folder):
    (folder / "bad.xyz").write_text("# xyz rgb\n1 2 3\n")
    done = run_with(folder / "site", folder, "inspect", "bad.xyz")
    assert done.returncode == 2
    assert "bad.xyz: file format 'xyz' cannot read it: 3 columns, not 6" in done.stderr


def test_file_and_name_of_a_format_that_is_not_installed_are_refused(folder, tmp_path):
    done = run_with(tmp_path, folder, "inspect", "points.xyz")
    assert done.returncode == 2
    assert "it looks like a text file" in done.stderr
    done = run_with(tmp_path, folder, "export", "xyz", "scene.ply", "-o", "other.xyz")
    assert done.returncode == 2
    assert "unknown format of explicit Gaussians 'xyz': known are compressed.ply, glb, ply" in done.stderr


@pytest.mark.parametrize("content", [HEAD + b"\0" * 9, b"TOY text\n", b'{"toy": 1}'])
def test_recognised_file_is_read_and_other_formats_are_unaffected(register, tmp_path, content):
    register(toy(recognises=lambda head, suffix: head.startswith(content[:4])))
    (tmp_path / "a.bin").write_bytes(content)
    assert file_kind(tmp_path / "a.bin").key == splats_kind(tmp_path / "a.bin") == "toy"
    assert open_scene(tmp_path / "a.bin").num_elements == 50
    write_splats([some_splats()], tmp_path / "a.ply")
    register(toy(name="greedy", recognises=lambda head, suffix: True))
    assert splats_kind(tmp_path / "a.ply") == "ply"


def test_written_file_appears_when_it_is_complete(register, tmp_path):
    def fails(parts, path):
        path.write_bytes(HEAD)
        raise InvalidValueError("half of it")

    register(toy(name="half", write=fails))
    with pytest.raises(InvalidValueError, match="half of it"):
        write_splats([some_splats()], tmp_path / "a.half")
    register(toy(name="lazy", write=lambda parts, path: 3))
    with pytest.raises(InvalidValueError, match="file format 'lazy' wrote no file"):
        write_splats([some_splats()], tmp_path / "a.lazy")
    assert not list(tmp_path.iterdir())


def test_scene_properties_that_a_format_cannot_store_give_a_warning(register, tmp_path, caplog):
    kept = []

    def write(parts, path, **facts):
        kept.append(facts)
        path.write_bytes(HEAD)

    register(toy(name="plain", write=write))
    register(toy(name="full", write=write, write_options=frozenset(("antialiased", "origin"))))
    with caplog.at_level(logging.WARNING):
        write_splats([some_splats()], tmp_path / "a.full", antialiased=True, origin=(1.0, 2.0, 3.0))
        assert caplog.text == ""
        write_splats([some_splats()], tmp_path / "a.plain", antialiased=True)
    assert kept == [{"antialiased": True, "origin": (1.0, 2.0, 3.0)}, {}]
    assert "such files cannot ask for antialiasing" in caplog.text


def test_former_name_of_write_options_gives_them_with_a_warning() -> None:
    form = toy(write_options=frozenset(("origin",)))
    with pytest.warns(DeprecationWarning, match="FileFormat.keeps is deprecated, use write_options"):
        assert form.keeps == {"origin"}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"name": "A B"}, "file format 'A B' is not complete: its name must be 1 to 32 lower-case letters"),
        ({"description": ""}, "its description must name such a file"),
        ({"read": None, "write": None}, "it neither reads nor writes"),
        ({"recognises": None}, "recognises is missing"),
        ({"read": 3}, "read cannot be called"),
        ({"scene_type": "Points"}, "scene_type must be a class, not 'Points'"),
        (
            {"write_options": frozenset(("colour",))},
            "write_options has colour; known are antialiased, metadata",
        ),
        ({"name": "spz"}, "two file formats are called 'spz': splatwire.io.formats"),
    ],
)
def test_format_that_is_not_complete_is_refused(changes, sentence):
    form = toy()
    for part, value in changes.items():
        object.__setattr__(form, part, value)
    with pytest.raises(InvalidValueError, match=sentence):
        register_format(form)
    assert "toy" not in FORMATS.registered()


def test_reader_that_returns_something_else_is_one_sentence(register, tmp_path):
    (tmp_path / "a.bin").write_bytes(HEAD)
    register(toy(read=lambda path: 3))
    with pytest.raises(SplatwireError, match="file format 'toy' returned int, not FileContent or Splats"):
        read_content(tmp_path / "a.bin")


def test_detector_that_raises_gives_a_warning(register, tmp_path, caplog):
    (tmp_path / "a.bin").write_bytes(HEAD)
    register(toy(recognises=lambda head, suffix: 1 / 0))
    with caplog.at_level(logging.WARNING):
        assert file_kind(tmp_path / "a.bin").key == "unknown"
    assert "file format 'toy' cannot look at a file: ZeroDivisionError" in caplog.text


def test_format_of_other_scenes_takes_only_those(register, tmp_path):
    register(toy(name="other", scene_type=dict))
    write_splats([some_splats()], tmp_path / "a.ply")
    with pytest.raises(InvalidValueError, match="a toy file holds scenes of the type dict, not SplatScene"):
        save_scene(open_scene(tmp_path / "a.ply"), tmp_path / "a.other")
    with pytest.raises(InvalidValueError, match="a toy file holds scenes of the type dict, not explicit Gaussians"):
        write_splats([some_splats()], tmp_path / "a.other")
    (tmp_path / "b.bin").write_bytes(HEAD)
    with pytest.raises(InvalidValueError, match="file format 'other' returned Splats, not dict"):
        open_scene(tmp_path / "b.bin")


def test_error_of_an_unknown_suffix_lists_all_suffixes(register):
    register(toy(name="listed"))
    with pytest.raises(UnknownNameError, match=r"known are compressed\.ply, glb, listed, ply, sog, splat, spz"):
        format_for("a.stl")
