"""A row pays for what its concealer reads: its own section or file, never those of others."""

from pathlib import Path

import pytest

from scenes import tiny_scene
from splatwire.codec import add_concealment, encode_scene
from splatwire.evaluate.total_bytes import bytes_needed
from splatwire.packets import Packetization


@pytest.fixture(scope="module")
def bare():
    return encode_scene(tiny_scene(seed=5, num_anchors=120), Packetization(block_size=60))


@pytest.fixture(scope="module")
def carrying(bare):
    """Sections for two concealers, and one that is not of a concealer."""
    stream = bare
    for name, size in (("sketch", 300), ("gnn", 70), ("notes", 40)):
        stream = add_concealment(stream, name, bytes(size))
    return stream


def test_only_the_own_section_counts(bare, carrying):
    notes = add_concealment(bare, "notes", bytes(40))
    assert bytes_needed(carrying, "drop") == bytes_needed(carrying, "cari") == notes.num_bytes
    for name, size in (("sketch", 300), ("gnn", 70)):
        assert bytes_needed(carrying, name) == add_concealment(notes, name, bytes(size)).num_bytes
    assert bytes_needed(bare, "drop") == bare.num_bytes


def test_weights_from_a_file_count_as_the_file(bare, carrying, tmp_path: Path):
    file = tmp_path / "weights"
    file.write_bytes(bytes(1234))
    assert bytes_needed(bare, f"gnn:{file}") == bare.num_bytes + 1234
    assert bytes_needed(carrying, f"gnn:{file}") == bytes_needed(carrying, "drop") + 1234
