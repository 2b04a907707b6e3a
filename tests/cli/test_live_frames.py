"""`live` continues after damaged, truncated, removed, deviating, late or excess frames."""

import contextlib
import itertools
import os
import select
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moving_sequences import moving_frames
from splatwire.bitstream import packet_from_bytes
from splatwire.cli._live_warnings import WARN_S, Warnings, print_if_read
from splatwire.cli._terminal import PrintableStream, printable_streams
from splatwire.errors import InvalidValueError
from splatwire.io.formats import write_splats
from splatwire.sequence import SequenceEncoder, SequenceFrame, SequenceOptions, frame_sources
from splatwire.sequence.frame_sources import POLL_INTERVAL_S, DropPolicy, FolderSource, PipeSource
from splatwire.sequence.frame_writer import numbered
from splatwire.sequence.live_decoder import LiveDecoder
from splatwire.sequence.live_encoder import LiveEncoder
from splatwire.sequence.live_ingest import NUM_FRAMES_TO_ADOPT, LiveIngest
from splatwire.transport import fec
from splatwire.transport.protocol.layout import SourceBlocks, split_init_segment
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

GROUP = 2
RATE = 10
MAP = (448_262.0, 5_411_932.0, 112.0)
"""Origin of a scene in map coordinates (UTM)."""


@dataclass
class FakeClip:
    """Accepts frames without encoding them and records the number of Gaussians of each."""

    counts: list[int] = field(default_factory=list)
    restarts: list[int] = field(default_factory=list)
    refuses: int | None = None
    seconds: float = 0.0
    world: "World | None" = None

    @property
    def num_frames(self) -> int:
        return len(self.counts)

    def push(self, frame):
        if frame.splats.num_gaussians == self.refuses:
            raise InvalidValueError("these tracks are too many")
        self.counts.append(frame.splats.num_gaussians)
        if self.world is not None:
            self.world.pass_time(self.seconds)

    def restart(self):
        self.restarts.append(len(self.counts))

    def end(self):
        return []


class World:
    """A folder with a writer, and a clock that advances while the encoder waits."""

    def __init__(self, folder: Path, clip=None) -> None:
        folder.mkdir()
        self.folder, self.now, self.said = folder, 0.0, list[str]()
        self.clip = FakeClip() if clip is None else clip
        self.plan: list[tuple[float, object]] = []
        self.end = 3.0
        self.editions = list[Any]()
        source = FolderSource(folder, self.said.append, wall_clock=lambda: 0.0)  # no file is old
        self.live = LiveIngest(
            source, self.clip, SequenceOptions(Fraction(RATE), GROUP), self.editions.append,
            lambda: self.now >= self.end, self.said.append, clock=lambda: self.now, sleep=self.pass_time,
        )  # fmt: skip

    def pass_time(self, seconds: float) -> None:
        self.now += max(seconds, 1e-4)
        while self.plan and self.plan[0][0] <= self.now:
            self.plan.pop(0)[1]()

    def at(self, seconds: float, action) -> None:
        self.plan.append((seconds, action))
        self.plan.sort(key=lambda item: item[0])

    def frame(self, number: int, count: int | None = None, suffix: str = ".ply") -> Path:
        """Renames a frame into place; its number of Gaussians identifies it."""
        target = self.folder / f"frame_{number:04}{suffix}"
        made = self.folder / f".making{suffix}"
        write_splats([splats(count or 100 + number)], made)
        return made.replace(target)

    def run(self, seconds: float | None = None):
        self.end = self.end if seconds is None else seconds
        self.live.run()
        return self.clip.counts


def splats(count: int, degree: int = 0) -> Splats:
    made = moving_frames(count, 1)[0]
    shown = Splats(made.means, made.quats, made.scales, made.opacities.clip(0.5), made.sh)
    if degree:
        sh = np.zeros((count, (degree + 1) ** 2, 3), np.float32)
        shown = Splats(shown.means, shown.quats, shown.scales, shown.opacities, sh)
    return shown


def half(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def not_numbers(path: Path) -> None:
    header, rows = path.read_bytes().split(b"end_header\n")
    path.write_bytes(header + b"end_header\n" + b"\xff" * len(rows))


ODD = {
    "truncated": half,
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("nothing of this kind"),
    "removed": lambda path: path.unlink(),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "a folder with a file": lambda path: (path.unlink(), path.mkdir(), (path / "a.png").write_bytes(b"x")),
    "a symlink to itself": lambda path: (path.unlink(), path.symlink_to(path.name)),
    "a symlink to nothing": lambda path: (path.unlink(), path.symlink_to("nowhere")),
    "a named pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "no row but NaN": not_numbers,
    "another degree": lambda path: write_splats([splats(30, degree=2)], path),
    "antialiasing": lambda path: write_splats([splats(30)], path, antialiased=True),
    "map coordinates": lambda path: write_splats([splats(30)], path, origin=MAP),
    "rows beyond its header": lambda path: path.write_bytes(path.read_bytes().replace(b"vertex 101", b"vertex 999")),
    "a count without end": lambda path: path.write_bytes(path.read_bytes().replace(b"x 101", b"x 99999999999")),
}  # fmt: skip


@pytest.mark.parametrize("how", ODD)
def test_deviating_frame_is_skipped_with_a_warning(tmp_path, how):
    world = World(tmp_path / "in")
    for number in (0, 1, 2, 3):
        world.frame(number)
    ODD[how](world.folder / "frame_0001.ply")
    assert world.run() == [100, 102, 103]
    if how not in ("removed", "a symlink to nothing"):
        assert len(world.said) == 1
        assert "frame_0001.ply" in world.said[0]


def test_an_unreadable_file_is_skipped(tmp_path, monkeypatch):
    world = World(tmp_path / "in")
    for number in (0, 1, 2):
        world.frame(number)
    real = Path.open

    def guarded(path, *arguments, **more):
        if path.name == "frame_0001.ply":
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, *arguments, **more)

    monkeypatch.setattr(Path, "open", guarded)
    (world.folder / "frame_0001.ply").chmod(0)
    assert world.run() == [100, 102]
    assert world.live.num_skipped == 1


def test_other_files_are_ignored_silently(tmp_path):
    world = World(tmp_path / "in")
    world.frame(0)
    (world.folder / "notes.txt").write_text("x")
    (world.folder / "frame_0001.ply.part").write_bytes((world.folder / "frame_0000.ply").read_bytes())
    (world.folder / ".frame_0001.ply").write_bytes((world.folder / "frame_0000.ply").read_bytes())
    world.frame(2)
    assert world.run() == [100, 102]
    assert world.said == []


@pytest.mark.parametrize("pause", [0.1, 0.3, 2.0])
def test_partially_written_file_is_read_once_complete(tmp_path, pause):
    world = World(tmp_path / "in")
    world.frame(0)
    data = world.frame(1).read_bytes()
    path = world.folder / "frame_0001.ply"
    path.write_bytes(data[: len(data) // 2])
    world.at(pause, lambda: path.write_bytes(data))
    world.at(pause + 0.03, lambda: world.frame(2))
    assert world.run(4.0) == [100, 101, 102]
    assert world.said == []


def test_partial_file_of_a_format_without_count_is_awaited(tmp_path):
    world = World(tmp_path / "in")
    data = world.frame(0, suffix=".splat").read_bytes()
    path = world.folder / "frame_0000.splat"
    path.write_bytes(data[: 32 * 40])
    world.at(0.3, lambda: path.write_bytes(data))
    assert world.run() == [100]


def test_endlessly_growing_file_does_not_block_other_frames(tmp_path):
    world = World(tmp_path / "in")
    path = world.folder / "frame_0000.ply"
    for tick in range(400):
        world.at(tick * 0.05, lambda tick=tick: path.write_bytes(b"ply\n" + b"x" * tick))
    world.at(0.1, lambda: world.frame(1))
    assert world.run(15.0) == [101]
    assert len(world.said) == 1
    assert "frame_0000.ply" in world.said[0]


def test_frame_that_grew_while_nothing_checked_the_folder_is_not_skipped(tmp_path: Path) -> None:
    """Compilation may stop the checks for many seconds."""
    said: list[str] = []
    source = FolderSource(tmp_path, said.append, wall_clock=lambda: 0.0)
    first, second = tmp_path / "frame_0.ply", tmp_path / "frame_1.ply"
    first.write_bytes(b"x")
    second.write_bytes(b"x")
    assert source.poll(0.0) == []
    first.write_bytes(b"xx")
    assert source.poll(30.0) == []
    assert source.poll(30.1) == [first, second]
    assert said == []


@pytest.mark.parametrize("interval", [0.03, 0.4, 1.0])
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_changing_file_that_is_no_frame_is_ignored_after_one_warning(tmp_path, monkeypatch, kind, interval):
    world = World(tmp_path / "in")
    other, looks = world.folder / "work", []
    (other / "deep").mkdir(parents=True) if kind == "folder" else other.touch()
    sign = frame_sources.signature_of

    def signed(path, status):
        looks.extend([world.now] if Path(path) == other else [])
        return sign(path, status)

    monkeypatch.setattr(frame_sources, "signature_of", signed)
    for tick in range(round(60 / interval)):
        changed = other / "log" if kind == "folder" else other
        world.at(tick * interval, lambda tick=tick, changed=changed: changed.write_bytes(b"x" * (tick + 1)))
    world.at(50.0, lambda: world.frame(1))
    assert world.run(60.0) == [101]
    assert world.said == [f"{other} is no frame and keeps changing: ignored until it is removed"]
    assert max(looks) < 30


def test_stalled_writer_does_not_end_the_clip(tmp_path):
    world = World(tmp_path / "in")
    world.frame(0)
    world.at(30.0, lambda: world.frame(1))
    assert world.run(31.0) == [100, 101]


def test_vanished_folder_is_awaited(tmp_path):
    world = World(tmp_path / "in")
    world.frame(0)

    def vanish():
        for path in world.folder.iterdir():
            path.unlink()
        world.folder.rmdir()

    world.at(0.5, vanish)
    world.at(1.0, lambda: (world.folder.mkdir(), world.frame(1)))
    assert world.run() == [100, 101]
    assert "waiting for it" in world.said[0]


@pytest.mark.parametrize("how", ["moved in", "written in place", "removed before"])
def test_repeated_file_name_is_a_new_frame(tmp_path, how):
    world = World(tmp_path / "in")
    path = world.frame(0)

    def again():
        if how == "moved in":
            world.frame(0, 150)
            return
        if how == "removed before":
            path.unlink()
        write_splats([splats(150)], path)

    world.at(0.5, again)
    assert world.run() == [100, 150]


def test_file_that_was_missing_when_it_was_read_is_returned_once_it_is_there(tmp_path):
    source = FolderSource(tmp_path, print, wall_clock=lambda: 0.0)
    path = tmp_path / "frame_0.ply"
    path.write_bytes(b"x")
    assert [source.poll(now) for now in (0.0, 1.0)] == [[], [path]]
    path.unlink()
    source.mark_read(path, frame_sources.signature_at(path))
    path.write_bytes(b"x")  # before the folder is listed again
    assert [source.poll(now) for now in (2.0, 3.0, 4.0)] == [[], [path], []]


def test_many_earlier_files_are_checked_rarely_and_new_files_at_once(tmp_path, monkeypatch):
    count = 5000
    earlier = [tmp_path / f"frame_{number}.ply" for number in range(count)]
    for path in earlier:
        path.write_bytes(b"x")
    real, checked = frame_sources.signature_of, list[str]()

    def counted(path, status):
        checked.append(str(path))
        return real(path, status)

    monkeypatch.setattr(frame_sources, "signature_of", counted)
    source = FolderSource(tmp_path, print, wall_clock=lambda: 0.0)
    source.poll(0.0)
    assert source.poll(0.5) == earlier
    for path in earlier:
        source.mark_read(path, frame_sources.signature_at(path))
    checked.clear()
    new = tmp_path / "frame_5000.ply"
    new.write_bytes(b"x")
    earlier[7].write_bytes(b"changed")
    found = [(now, path) for now in (1 + step * POLL_INTERVAL_S for step in range(50)) for path in source.poll(now)]
    assert sorted(path for _, path in found) == sorted([new, earlier[7]])
    assert min(now for now, path in found if path == new) < 1.05
    assert len(checked) < 7 * count


def test_unencodable_group_is_dropped_and_the_next_starts_a_new_period(tmp_path):
    world = World(tmp_path / "in", FakeClip(refuses=102))
    for number in range(5):
        world.frame(number)
    assert world.run() == [100, 101, 103, 104]
    assert world.clip.restarts == [2]
    assert "too many" in world.said[0]


@pytest.mark.parametrize("num_frames", [GROUP + 1, 1])
def test_a_live_clip_whose_last_group_cannot_be_encoded_ends_with_the_groups_before(tmp_path, num_frames, monkeypatch):
    def refuse(self):
        raise InvalidValueError("these tracks are too many")

    monkeypatch.setattr(SequenceEncoder, "flush", refuse)
    world = World(tmp_path / "in", LiveEncoder(SequenceOptions(Fraction(RATE), GROUP), lambda: 7))
    for number in range(num_frames):
        world.frame(number)
    world.live.run()
    assert [text for text in world.said if "too many" in text] == world.said
    assert (len(world.said), world.live.num_skipped, world.live.num_frames) == (1, 1, num_frames // GROUP * GROUP)
    assert [state.is_live for state in world.editions] == ([True, False] if num_frames > GROUP else [])
    assert len({state.packets for state in world.editions}) == num_frames // GROUP


def test_a_live_clip_of_empty_frames_ends_without_an_error(tmp_path):
    world = World(tmp_path / "in", LiveEncoder(SequenceOptions(Fraction(RATE), GROUP), lambda: 7))
    for number in range(GROUP - 1):
        empty_frame(world.folder / f"frame_{number:04}.ply")
    world.live.run()
    assert world.editions == []
    assert ["no Gaussian that draws anything" in text for text in world.said] == [True]


def test_persistent_new_degree_is_accepted_after_some_frames(tmp_path):
    ids = itertools.count(7)
    clip = LiveEncoder(SequenceOptions(Fraction(RATE), GROUP), lambda: next(ids))
    world = World(tmp_path / "in", clip)
    world.frame(0)
    world.frame(1)
    for number in range(2, 2 + NUM_FRAMES_TO_ADOPT + 3):
        write_splats([splats(40, degree=1)], world.folder / f"frame_{number:04}.ply")
    world.end = 6.0
    world.live.run()
    assert world.live.num_skipped == NUM_FRAMES_TO_ADOPT - 1
    streams = {edition.stream_id: edition for edition in world.editions}
    assert list(streams) == [7, 8]
    shown = decoded(world.editions)
    assert [frame.number for frame in shown] == list(range(2 + 4))
    assert [frame.scene.splats.degree for frame in shown] == [0, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("origins", [((0.0, 0.0, 0.0), MAP), (MAP, (0.0, 0.0, 0.0))], ids=["to a map", "from a map"])
def test_persistent_distant_origin_is_accepted_after_some_frames(tmp_path, origins):
    """The frames before and after it keep precise positions."""
    ids = itertools.count(7)
    world = World(tmp_path / "in", LiveEncoder(SequenceOptions(Fraction(RATE), GROUP), lambda: next(ids)))
    for number in range(2 + NUM_FRAMES_TO_ADOPT + 3):
        write_splats([splats(100)], world.folder / f"frame_{number:04}.ply", origin=origins[number >= 2])
    world.end = 6.0
    world.live.run()
    assert world.live.num_skipped == NUM_FRAMES_TO_ADOPT - 1
    assert "positions near" in world.said[0]
    shown = decoded(world.editions)
    assert [frame.number for frame in shown] == list(range(2 + 4))
    for frame in shown:
        origin = np.array(origins[frame.number >= 2])
        assert np.abs(np.array(frame.scene.origin) - origin).max() < 10
        means = np.sort(frame.scene.splats.means + (np.array(frame.scene.origin) - origin), axis=0)
        assert np.allclose(means, np.sort(splats(100).means, axis=0), atol=0.01)


def empty_frame(path: Path) -> None:
    """Writes a file as this package does for an empty frame: one transparent Gaussian at 0."""
    one = splats(1)
    write_splats([Splats(np.zeros_like(one.means), one.quats, one.scales, np.zeros_like(one.opacities), one.sh)], path)


@pytest.mark.parametrize("num_first", [0, 1, 2 * GROUP + 1])
def test_empty_frames_among_frames_in_map_coordinates_do_not_choose_an_origin(tmp_path, num_first, caplog):
    ids = itertools.count(7)
    world = World(tmp_path / "in", LiveEncoder(SequenceOptions(Fraction(RATE), GROUP), lambda: next(ids)))
    kinds = "e" * num_first + "fff" + "e" * (NUM_FRAMES_TO_ADOPT + 2) + "fff"
    for number, kind in enumerate(kinds):
        path = world.folder / f"frame_{number:04}.ply"
        if kind == "e":
            empty_frame(path)
        else:
            write_splats([splats(100)], path, origin=MAP)
    world.end = 6.0
    world.live.run()
    assert all("no Gaussian that draws anything" in text for text in world.said)  # groups without any Gaussian
    assert world.live.num_skipped == len(world.said) == num_first // GROUP
    assert "from the origin" not in caplog.text
    shown = [frame for frame in decoded(world.editions) if frame.scene.drawn().num_gaussians]
    assert len(shown) == 6
    for frame in shown:
        assert np.abs(np.array(frame.scene.origin) - MAP).max() < 10
        means = np.sort(frame.scene.drawn().means + (np.array(frame.scene.origin) - MAP), axis=0)
        assert np.allclose(means, np.sort(splats(100).means, axis=0), atol=0.01)


def test_frames_with_origins_near_each_other_are_one_stream(tmp_path):
    world = World(tmp_path / "in")
    for number in range(6):
        x, y, z = MAP
        write_splats([splats(100 + number)], world.folder / f"frame_{number:04}.ply", origin=(x + 40 * number, y, z))
    assert world.run() == [100 + number for number in range(6)]
    assert world.said == []


def decoded(editions):
    """Frames that a viewer gets from the updates of a live stream."""
    decoder, frames, known = LiveDecoder(), [], set()
    for edition in editions:
        manifest, side_info, _ = split_init_segment(b"".join(head_of(edition)))
        frames += decoder.update_header(manifest, side_info)
        new = [data for data in edition.packets if data and data not in known]
        known.update(new)
        frames += decoder.add([packet_from_bytes(data, edition.stream_id) for data in new])
    return frames + list(decoder.finish())


def head_of(edition):
    """Bytes of manifest, side information and source symbols of a served stream."""
    source_blocks = SourceBlocks(edition.init_segment_bytes, edition.symbol_bytes)
    for number in range(source_blocks.num_blocks):
        span, size = source_blocks.span(number), source_blocks.size(number)
        symbols = dict(list(enumerate(edition.init_symbols[number]))[:size])
        yield b"".join(fec.recover(symbols, size, edition.symbol_bytes))[: span.stop - span.start]


def test_a_slow_encoder_drops_frames_and_its_delay_stays_bounded(tmp_path):
    world = World(tmp_path / "in")
    world.clip.world, world.clip.seconds = world, 0.3  # three frame durations
    delays = []
    real = world.clip.push

    def push(frame):
        delays.append(world.now - (frame.splats.num_gaussians - 100) / RATE)
        real(frame)

    world.clip.push = push
    for number in range(300):
        world.at(number / RATE, lambda number=number: world.frame(number))
    world.run(30.0)
    assert max(delays) < 8.0
    assert max(delays[len(delays) // 2 :]) <= max(delays[: len(delays) // 2]) + 1.0
    assert world.live.num_dropped > 100
    assert "dropped" in world.said[0]


def test_shrinking_queue_is_kept_and_persistent_queue_is_shortened():
    drains, stands = DropPolicy(30.0, 15), DropPolicy(30.0, 15)
    steps = [n * POLL_INTERVAL_S for n in range(500)]
    assert not any(drains.surplus(600 - round(30 * now), now) for now in steps)
    cut = [stands.surplus(300, now) for now in steps]
    assert max(cut) == 297
    assert sum(map(bool, cut[:99])) == 0


def test_preexisting_frames_are_all_shown_at_the_frame_rate(tmp_path):
    world = World(tmp_path / "in")
    for number in range(40):
        world.frame(number)
    assert world.run(10.0) == [100 + number for number in range(40)]
    assert world.live.num_dropped == 0


def test_file_names_from_a_pipe_are_read_completely_until_it_closes():
    read, write = os.pipe()
    said = []
    source = PipeSource(read, said.append)
    os.write(write, b"a.ply\nb.p")
    assert source.poll(0.0) == [Path("a.ply")]
    os.write(write, b"ly\n\n\0\n")
    assert source.poll(0.0) == [Path("b.ply"), Path("\0")]
    os.write(write, b"last.ply")
    os.close(write)
    assert source.poll(0.0) == [Path("last.ply")]
    assert source.ended
    os.close(read)


def test_pipe_names_without_files_are_skipped(tmp_path):
    world = World(tmp_path / "in")
    read, write = os.pipe()
    good = world.frame(0)
    os.mkfifo(tmp_path / "blocks.ply")
    names = (str(good), "nowhere.ply", "\0.ply", str(tmp_path / "blocks.ply"), "/dev/zero", str(tmp_path), str(good))
    os.write(write, "\n".join(names).encode())
    os.close(write)
    world.live._source = PipeSource(read, world.said.append)
    assert world.run(30.0) == [100, 100]
    assert world.live.num_skipped == 5
    os.close(read)


def test_warnings_are_rate_limited_and_count_the_suppressed():
    now, shown = [0.0], []
    warn = Warnings(lambda: now[0], shown.append)
    for number in range(100):
        warn(f"frame {number}")
    now[0] = WARN_S
    warn("frame\n100")
    assert shown == [
        "splatwire: warning: frame 0",
        "splatwire: warning: frame 100 (99 other warnings since the last one)",
    ]


def test_blocked_standard_error_does_not_stop_the_clip(monkeypatch):
    """A full pipe blocked the encoder, and Ctrl-C had no effect until the pipe was read."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(write, b"x" * 65536)
    os.set_blocking(write, True)
    with os.fdopen(write, "w") as full, printable_streams():
        monkeypatch.setattr("sys.stderr", PrintableStream(full))
        print_if_read("nobody reads this")
        while os.read(read, 1 << 20)[-1:] == b"x" and select.select([read], [], [], 0)[0]:
            pass
        print_if_read("this is read")
    assert os.read(read, 100) == b"this is read\n"
    os.close(read)


@pytest.mark.parametrize("name", ["1²3.ply", "²", "٣.ply", "1" * 200 + ".ply", "\x1b[31m.ply"])
def test_file_names_of_any_form_are_sorted(tmp_path, name):
    world = World(tmp_path / "in")
    world.frame(1).rename(world.folder / name)
    world.frame(2)
    assert sorted(world.run()) == [101, 102]


def test_restarted_server_continues_frame_numbers(tmp_path):
    """The restarted server counts from 0, and files of earlier frames are kept."""
    scene = SplatScene(splats(5))
    numbers = [3, 4, 5, 0, 1, 4, 10]
    every = np.arange(5)
    frames = numbered(SequenceFrame(number, scene, every, every < 0) for number in numbers)
    assert [number for _, number in frames] == [3, 4, 5, 6, 7, 10, 16]
