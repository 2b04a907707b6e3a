"""Written as a whole or not at all: errors, ended and killed writers, a full disk."""

import errno
import os
import signal
import subprocess
import sys
import threading

import pytest

from splatwire.errors import InvalidValueError
from splatwire.files import whole
from splatwire.files.whole import remove_unfinished, write_whole, written_whole

WAIT = (
    "import sys, time\n"
    "from pathlib import Path\n"
    "from splatwire.files.whole import written_whole\n"
    "with written_whole(Path(sys.argv[1])) as new:\n"
    "    new.write_bytes(b'half')\n"
    "    print('writing', flush=True)\n"
    "    time.sleep(60)\n"
)


def hidden(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def kill_a_writer(target, number):
    writer = subprocess.Popen([sys.executable, "-c", WAIT, str(target)], stdout=subprocess.PIPE)
    assert writer.stdout.readline() == b"writing\n"
    writer.send_signal(number)
    writer.wait()
    writer.stdout.close()


def test_a_file_takes_its_name_at_the_end(tmp_path):
    write_whole(tmp_path / "new" / "a", b"old")
    with written_whole(tmp_path / "new" / "a") as new:
        new.write_bytes(b"new")
        assert (tmp_path / "new" / "a").read_bytes() == b"old"
        assert new.name == "a"
    assert (tmp_path / "new" / "a").read_bytes() == b"new"
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a"]


def test_a_folder_replaces_a_folder_as_a_whole(tmp_path):
    for name in ("one", "two"):
        with written_whole(tmp_path / "a") as new:
            new.mkdir()
            (new / name).touch()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["two"]
    assert not hidden(tmp_path)


@pytest.mark.parametrize("problem", [ValueError, KeyboardInterrupt, SystemExit, OSError])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, problem):
    (tmp_path / "a").write_bytes(b"old")

    def write():
        with written_whole(tmp_path / "a") as new:
            new.write_bytes(b"half")
            raise problem

    with pytest.raises(problem):
        write()
    assert (tmp_path / "a").read_bytes() == b"old"
    assert not hidden(tmp_path)


def test_errors_name_the_target_not_the_hidden_folder(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    with pytest.raises(IsADirectoryError, match=f"'{tmp_path}/a'$"):
        write_whole(tmp_path / "a", b"")

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=f"No space left.*'{tmp_path}/b'$"):
        write_whole(tmp_path / "b", b"")
    assert not hidden(tmp_path)


def test_a_link_is_followed_and_a_device_refused(tmp_path):
    (tmp_path / "there").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    write_whole(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there").read_bytes() == b"new"
    with pytest.raises(InvalidValueError, match="no ordinary file"):
        write_whole("/dev/null", b"")


@pytest.mark.parametrize("name", ["same", "other"])
def test_the_next_writer_removes_what_a_killed_one_left(tmp_path, name):
    kill_a_writer(tmp_path / "same", signal.SIGKILL)
    assert len(hidden(tmp_path)) == 1
    write_whole(tmp_path / name, b"whole")
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_living_writers_are_left_alone(tmp_path):
    with written_whole(tmp_path / "a") as new:
        new.write_bytes(b"a")
        other = threading.Thread(target=write_whole, args=(tmp_path / "b", b"b"))
        other.start()
        other.join()
        remove_unfinished(tmp_path)
        assert new.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_folder_that_a_killed_writer_moved_aside_comes_back(tmp_path):
    """Killed between two renames: neither the old nor the new folder has its name."""
    space = tmp_path / ".splatwire-0123456789ab.part"
    (space / "old" / "stream").mkdir(parents=True)
    (space / "old" / "stream" / "packet").touch()
    (space / "new" / "stream").mkdir(parents=True)
    remove_unfinished(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["stream"]
    assert [path.name for path in (tmp_path / "stream").iterdir()] == ["packet"]


def test_only_its_own_is_removed(tmp_path):
    for name in (".splatwire-notes", ".hidden.part", "splatwire-x.part"):
        (tmp_path / name).mkdir()
    (tmp_path / "kept").mkdir()
    (tmp_path / ".splatwire-link.part").symlink_to(tmp_path / "kept")
    remove_unfinished(tmp_path)
    assert len(list(tmp_path.iterdir())) == 5


def test_no_link_in_a_workspace_is_followed(tmp_path):
    """A folder from elsewhere has links in names that look like those of a killed writer."""
    secret = tmp_path / "home" / ".ssh"
    secret.mkdir(parents=True)
    (secret / "id").write_bytes(b"key")
    clone = tmp_path / "clone"
    spaces = [clone / f".splatwire-{n:012x}.part" for n in range(5)]
    for space in spaces[:3]:
        space.mkdir(parents=True)
    (spaces[0] / "old").symlink_to(tmp_path / "home")
    (spaces[1] / "old").mkdir()
    (spaces[1] / "old" / "b").symlink_to(secret)
    (spaces[1] / "old" / "c").symlink_to(secret / "id")
    (spaces[2] / "new").symlink_to(tmp_path / "home")
    spaces[3].symlink_to(tmp_path / "home")
    write_whole(clone / "a", b"whole")
    assert (secret / "id").read_bytes() == b"key"
    assert not (clone / ".ssh").exists()
    assert sorted(path.name for path in clone.iterdir()) == [spaces[3].name, "a"]


@pytest.mark.parametrize("name", [".splatwire-x.part", ".splatwire-0123456789AB.part", ".splatwire-0123456789ab.part "])
def test_names_that_no_writer_makes_are_left_alone(tmp_path, name):
    (tmp_path / name / "old" / "stream").mkdir(parents=True)
    write_whole(tmp_path / "a", b"whole")
    assert (tmp_path / name / "old" / "stream").is_dir()
    assert not (tmp_path / "stream").exists()


def test_what_another_user_left_is_left_alone(tmp_path, monkeypatch):
    (tmp_path / ".splatwire-0123456789ab.part" / "old" / "stream").mkdir(parents=True)
    monkeypatch.setattr(os, "geteuid", lambda: os.stat(tmp_path).st_uid + 1)
    remove_unfinished(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".splatwire-0123456789ab.part"]


def test_a_link_in_the_way_is_not_replaced_by_what_was_moved_aside(tmp_path):
    (tmp_path / ".splatwire-0123456789ab.part" / "old" / "stream").mkdir(parents=True)
    (tmp_path / "stream").symlink_to(tmp_path / "nowhere")
    remove_unfinished(tmp_path)
    assert (tmp_path / "stream").is_symlink()
    assert not (tmp_path / "nowhere").exists()


def test_a_folder_that_becomes_a_link_while_it_is_restored_is_not_followed(tmp_path, monkeypatch):
    (tmp_path / "home" / "old" / "secret").mkdir(parents=True)
    clone, locked = tmp_path / "clone", whole._lock
    space = clone / ".splatwire-0123456789ab.part"
    (space / "old" / "stream").mkdir(parents=True)

    def swapped(handle):
        found = locked(handle)
        space.rename(clone / "moved")
        space.symlink_to(tmp_path / "home")
        return found

    monkeypatch.setattr(whole, "_lock", swapped)
    remove_unfinished(clone)
    assert (tmp_path / "home" / "old" / "secret").is_dir()
    assert not (clone / "secret").exists()


def test_a_workspace_is_open_to_its_user_alone_and_the_result_is_not(tmp_path):
    with written_whole(tmp_path / "a") as new:
        assert (tmp_path / hidden(tmp_path)[0]).stat().st_mode & 0o777 == 0o700
        new.mkdir()
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o777 & ~_umask()


def _umask() -> int:
    before = os.umask(0)
    os.umask(before)
    return before


def test_a_folder_that_was_taken_for_a_dead_writers_is_made_anew(tmp_path, monkeypatch):
    """Another process sweeps between the making of the hidden folder and its lock."""
    lock, calls = whole._lock, []

    def late(handle):
        calls.append(handle)
        if len(calls) == 1:
            (tmp_path / hidden(tmp_path)[0]).rmdir()
        return lock(handle)

    monkeypatch.setattr(whole, "_lock", late)
    write_whole(tmp_path / "a", b"whole")
    assert len(calls) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_folder_that_is_gone_before_it_is_locked_is_made_anew(tmp_path, monkeypatch):
    opened, tried = os.open, []

    def too_late(path, flags, *rest, **more):
        if str(path).endswith(".part") and not tried:
            tried.append(path)
            os.rmdir(path)
        return opened(path, flags, *rest, **more)

    monkeypatch.setattr(os, "open", too_late)
    write_whole(tmp_path / "a", b"1")
    assert tried
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_link_that_leads_to_itself_is_refused(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises((InvalidValueError, OSError)), written_whole(tmp_path / "loop"):
        raise AssertionError
    assert os.readlink(tmp_path / "loop") == "loop"
