"""The bytes of a row include the section or file of its concealer, never those of others."""

from pathlib import Path

import pytest

from scenes import tiny_scene
from splatwire.bitstream import Packetization, write_stream
from splatwire.codec import encode_scene, with_section
from splatwire.evaluation.study.definition import Row, SceneEntry
from splatwire.evaluation.study.inputs import PreparedStream, Source, _parts
from splatwire.evaluation.study.parts import needed_stream, stream_parts


@pytest.fixture(scope="module")
def bare():
    return encode_scene(tiny_scene(seed=5, num_anchors=120), Packetization(block_size=60))


@pytest.fixture(scope="module")
def carrying(bare):
    """Stream with sections for two concealers, and a section that no concealer reads."""
    stream = bare
    for name, size in (("sketch", 300), ("gnn", 70), ("notes", 40)):
        stream = with_section(stream, name, bytes(size))
    return stream


def bytes_needed(stream, concealer):
    needed = needed_stream(stream, concealer)
    assert sum(stream_parts(needed).values()) == needed.num_bytes
    return needed.num_bytes


@pytest.mark.needs_torch
def test_bytes_include_only_the_section_of_the_concealer(bare, carrying):
    notes = with_section(bare, "notes", bytes(40))
    assert bytes_needed(carrying, "drop") == bytes_needed(carrying, "cari") == notes.num_bytes
    for name, size in (("sketch", 300), ("gnn", 70)):
        assert bytes_needed(carrying, name) == with_section(notes, name, bytes(size)).num_bytes
    assert bytes_needed(bare, "drop") == bare.num_bytes


def test_weights_file_replaces_the_section(bare, carrying):
    assert bytes_needed(bare, "gnn:file") == bare.num_bytes
    assert bytes_needed(carrying, "gnn:file") == bytes_needed(carrying, "drop")


def test_bytes_include_the_weights_file(bare, tmp_path: Path):
    (tmp_path / "weights").write_bytes(bytes(1234))
    write_stream(bare, tmp_path / "a.swz")
    row = Row("gnn", "gnn", None, "gnn:{weights}")
    source = Source(SceneEntry("a", tmp_path / "a.swz", "stream", cameras=tmp_path, weights=tmp_path / "weights"))
    parts = _parts(row, source, PreparedStream("a.swz", "", {}, 0, 0))
    assert sum(parts.values()) == bare.num_bytes + 1234
    assert parts["gnn_weights"] == 1234
