"""Files are written completely or not at all: errors, killed writers, a full disk."""

import errno
import itertools
import os
import shutil
import signal
import struct
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from splatwire.bitstream import read_stream
from splatwire.errors import BitstreamError, DatasetError, InvalidValueError
from splatwire.files import atomic_write as whole
from splatwire.files.atomic_write import (
    atomic_files,
    atomic_output,
    atomic_write,
    check_writable,
    is_unfinished,
    remove_unfinished,
)
from splatwire.files.kinds import UNFINISHED, file_kind
from splatwire.sequence.frames import frame_files

WAIT = (
    "import sys, time\n"
    "from pathlib import Path\n"
    "from splatwire.files.atomic_write import atomic_output\n"
    "with atomic_output(Path(sys.argv[1])) as new:\n"
    "    new.write_bytes(b'half')\n"
    "    print('writing', flush=True)\n"
    "    time.sleep(60)\n"
)


def hidden(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def workspace(folder, number=0x123456789AB, mode=0o700):
    """Creates a hidden folder like that of a killed writer."""
    space = folder / f".splatwire-{number:012x}.part"
    space.mkdir(parents=True)
    space.chmod(mode)
    return space


def kill_a_writer(target, number):
    writer = subprocess.Popen([sys.executable, "-c", WAIT, str(target)], stdout=subprocess.PIPE)
    assert writer.stdout.readline() == b"writing\n"
    writer.send_signal(number)
    writer.wait()
    writer.stdout.close()


def test_file_gets_its_name_when_complete(tmp_path):
    atomic_write(tmp_path / "new" / "a", b"old", parents=True)
    with atomic_output(tmp_path / "new" / "a") as new:
        new.write_bytes(b"new")
        assert (tmp_path / "new" / "a").read_bytes() == b"old"
        assert new.name == "a"
    assert (tmp_path / "new" / "a").read_bytes() == b"new"
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a"]


def test_folder_is_replaced_atomically(tmp_path):
    for name in ("one", "two"):
        with atomic_output(tmp_path / "a") as new:
            new.mkdir()
            (new / name).touch()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["two"]
    assert not hidden(tmp_path)


@pytest.mark.parametrize("problem", [ValueError, KeyboardInterrupt, SystemExit, OSError])
def test_error_keeps_the_old_file_only(tmp_path, problem):
    (tmp_path / "a").write_bytes(b"old")

    def write():
        with atomic_output(tmp_path / "a") as new:
            new.write_bytes(b"half")
            raise problem

    with pytest.raises(problem):
        write()
    assert (tmp_path / "a").read_bytes() == b"old"
    assert not hidden(tmp_path)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_errors_name_the_target_not_the_hidden_folder(tmp_path, monkeypatch, error):
    (tmp_path / "a").mkdir()
    with pytest.raises(IsADirectoryError, match=f"'{tmp_path}/a'$"):
        atomic_write(tmp_path / "a", b"")

    def full(descriptor):
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=f"{os.strerror(error)}.*'{tmp_path}/b'$"):
        atomic_write(tmp_path / "b", b"")
    assert not hidden(tmp_path)


def test_links_are_followed_and_devices_refused(tmp_path):
    (tmp_path / "there").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    atomic_write(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there").read_bytes() == b"new"
    with pytest.raises(InvalidValueError, match="no ordinary file"):
        atomic_write("/dev/null", b"")


def test_a_pipe_that_a_link_names_is_refused():
    """`/dev/stdout` is such a link if standard output is a pipe."""
    read, write = os.pipe()
    try:
        for refused in (lambda path: atomic_write(path, b""), lambda path: check_writable(Path(path))):
            with pytest.raises(InvalidValueError, match="no ordinary file"):
                refused(f"/dev/fd/{write}")
    finally:
        os.close(read)
        os.close(write)


@pytest.mark.parametrize("number", range(3))
def test_ctrl_c_while_a_folder_is_replaced_loses_nothing(number, tmp_path, monkeypatch):
    """The old folder is renamed first, and removed with the temporary folder."""
    target = tmp_path / "stream"
    target.mkdir()
    (target / "old").touch()
    rename, count = Path.rename, itertools.count()

    def interrupted(path, to):
        if next(count) == number:
            raise KeyboardInterrupt
        return rename(path, to)

    with monkeypatch.context() as patched, suppress(KeyboardInterrupt), atomic_output(target) as new:
        new.mkdir()
        (new / "new").touch()
        patched.setattr(Path, "rename", interrupted)
    assert [path.name for path in tmp_path.iterdir()] == ["stream"]
    assert [path.name for path in target.iterdir()] == ["old" if number < 2 else "new"]


def test_ctrl_c_while_a_temporary_folder_is_made_leaves_none(tmp_path, monkeypatch):
    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(whole, "_lock", interrupted)
    with pytest.raises(KeyboardInterrupt):
        atomic_write(tmp_path / "a", b"")
    assert not list(tmp_path.iterdir())


def test_an_empty_folder_is_replaced_in_one_step_with_its_owner_and_permissions(tmp_path, monkeypatch):
    target = tmp_path / "a"
    target.mkdir()
    target.chmod(0o750)
    with suppress(ZeroDivisionError), atomic_output(target) as new:
        (new / "x").mkdir(parents=True)
        _ = 1 / 0
    assert not list(target.iterdir())
    rename, renamed = Path.rename, []
    monkeypatch.setattr(Path, "rename", lambda path, to: renamed.append(to) or rename(path, to))
    with atomic_output(target) as new:
        (new / "b").mkdir(parents=True)
        (new / "b" / "x").touch()
        (new / "y").touch()
        assert not (target / "y").exists()
    assert renamed == [target]
    assert sorted(str(path.relative_to(target)) for path in target.rglob("*")) == ["b", "b/x", "y"]
    assert target.stat().st_mode & 0o7777 == 0o750


def keep_folders(monkeypatch):
    monkeypatch.setattr(whole, "_must_be_kept", lambda _: True)


def test_a_folder_with_only_the_leftovers_of_a_killed_writer_is_kept_and_filled(tmp_path, monkeypatch):
    keep_folders(monkeypatch)
    target = tmp_path / "a"
    target.mkdir()
    number = target.stat().st_ino
    (workspace(target) / "new" / "a").mkdir(parents=True)
    with atomic_output(target) as new:
        new.mkdir()
        (new / "x").touch()
    assert os.listdir(target) == ["x"]
    assert target.stat().st_ino == number


def test_a_folder_that_cannot_be_replaced_is_filled(tmp_path, monkeypatch):
    """Such as a bind mount, which looks like an ordinary folder."""
    target, rename = tmp_path / "a", Path.rename
    target.mkdir()

    def refuse(path, to):
        if to == target:
            raise OSError(errno.EBUSY, "busy")
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", refuse)
    with atomic_output(target) as new:
        (new / "b").mkdir(parents=True)
        (new / "x").touch()
    assert sorted(os.listdir(target)) == ["b", "x"]
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.parametrize("number", range(4))
def test_ctrl_c_while_a_folder_is_filled_leaves_all_or_nothing(number, tmp_path, monkeypatch):
    keep_folders(monkeypatch)
    target, rename, count = tmp_path / "a", Path.rename, itertools.count()
    target.mkdir()

    def interrupted(path, to):
        if next(count) == number:
            raise KeyboardInterrupt
        return rename(path, to)

    with monkeypatch.context() as patched, suppress(KeyboardInterrupt), atomic_output(target) as new:
        for name in ("b", "c"):
            (new / name / "d").mkdir(parents=True)
        patched.setattr(Path, "rename", interrupted)
    assert sorted(os.listdir(target)) == ([] if number < 3 else ["b", "c"])


@pytest.fixture
def half_filled(tmp_path, monkeypatch):
    """Folder whose writer was killed after it had moved one of two files into it."""
    keep_folders(monkeypatch)
    target = tmp_path / "a"
    target.mkdir()
    (workspace(target) / "moving" / "a").mkdir(parents=True)
    (target / "x").write_bytes(b"first")
    (target / ".splatwire-0123456789ab.part" / "moving" / "a" / "y").write_bytes(b"second")
    return target


def test_a_partly_filled_folder_is_recognised_and_refused_by_readers(half_filled):
    assert is_unfinished(half_filled)
    assert file_kind(half_filled) == UNFINISHED
    with pytest.raises(BitstreamError, match="it is an output folder that a writer is filling, or did not finish"):
        read_stream(half_filled)


def test_a_partly_filled_folder_of_frames_is_refused(half_filled):
    (half_filled / "x").rename(half_filled / "1.ply")
    with pytest.raises(DatasetError, match="a writer is filling, or did not finish"):
        frame_files(half_filled)


def test_temporary_folders_of_other_users_do_not_hide_the_content_of_a_folder(tmp_path, monkeypatch):
    closed = workspace(tmp_path)

    def stat(path, **options):  # also for root, who may enter all folders
        if Path(path).is_relative_to(closed) and Path(path) != closed:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return real(path, **options)

    real = os.stat
    monkeypatch.setattr(os, "stat", stat)
    assert not is_unfinished(tmp_path)


def test_files_keep_those_of_a_program_that_filled_the_folder_meanwhile(tmp_path):
    with atomic_files(tmp_path / "a", "last") as new:
        (new / "x").write_bytes(b"ours")
        (new / "last").write_bytes(b"ours")
        (tmp_path / "a").mkdir()
        for name in ("x", "y"):
            (tmp_path / "a" / name).write_bytes(b"theirs")
    assert {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()} == {
        "x": b"ours", "y": b"theirs", "last": b"ours"
    }  # fmt: skip


@pytest.mark.parametrize("keeps", [False, True])
def test_files_are_added_to_a_folder_that_was_empty_and_that_a_program_filled_meanwhile(tmp_path, monkeypatch, keeps):
    monkeypatch.setattr(whole, "_must_be_kept", lambda _: keeps)
    target = tmp_path / "a"
    target.mkdir()
    with atomic_files(target, "last") as new:
        for name in ("x", "last"):
            (new / name).write_bytes(b"ours")
        for name in ("x", "y"):
            (target / name).write_bytes(b"theirs")
    assert {path.name: path.read_bytes() for path in target.iterdir()} == {
        "x": b"ours", "y": b"theirs", "last": b"ours"
    }  # fmt: skip


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES])
def test_a_full_disk_or_quota_is_named_by_a_copy_into_an_existing_folder(tmp_path, monkeypatch, code):
    target = tmp_path / "a"
    target.mkdir()

    def refuse(path, to):
        raise OSError(errno.EBUSY, "busy")

    def fail(source, into):
        raise shutil.Error([("a", "b", str(OSError(code, os.strerror(code), "b")))])

    monkeypatch.setattr(Path, "rename", refuse)
    monkeypatch.setattr(shutil, "copytree", fail)
    expected = errno.EIO if code == errno.EACCES else code
    with pytest.raises(OSError, match=f"^\\[Errno {expected}\\]"), atomic_output(target) as new:
        new.mkdir()
    assert not os.listdir(target)


def test_an_empty_folder_with_access_rules_for_new_files_is_kept(tmp_path):
    target = tmp_path / "a"
    target.mkdir()
    # version 2 and the rules of user, group and others (acl(5)): rwx, rwx, r-x
    rules = struct.pack("<I", 2) + b"".join(
        struct.pack("<HHI", kind, allowed, 0xFFFFFFFF) for kind, allowed in ((1, 7), (4, 7), (32, 5))
    )
    try:
        os.setxattr(target, "system.posix_acl_default", rules)
    except OSError:
        pytest.skip("the file system has no access control lists")
    number = target.stat().st_ino
    with atomic_output(target) as new:
        new.mkdir()
        (new / "x").write_bytes(b"x")
    assert target.stat().st_ino == number
    assert os.listdir(target) == ["x"]


def test_an_empty_folder_whose_group_is_inherited_is_kept(tmp_path):
    target = tmp_path / "a"
    target.mkdir()
    target.chmod(0o2755)
    number = target.stat().st_ino
    with atomic_output(target) as new:
        new.mkdir()
        (new / "x").write_bytes(b"x")
    assert target.stat().st_ino == number
    assert sorted(os.listdir(target)) == ["x"]


def test_what_cannot_be_moved_stays_for_the_next_writer(half_filled, monkeypatch):
    def refused(*paths, **folders):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", refused)
        remove_unfinished(half_filled)
    assert is_unfinished(half_filled)
    remove_unfinished(half_filled)
    assert sorted(os.listdir(half_filled)) == ["x", "y"]


def test_what_cannot_be_listed_stays_for_the_next_writer(half_filled, monkeypatch):
    scandir, count = os.scandir, itertools.count()

    def second_refused(folder):  # the output can be listed, its unmoved part cannot
        if next(count) == 1:
            raise OSError(errno.EMFILE, "Too many open files")
        return scandir(folder)

    with monkeypatch.context() as patched:
        patched.setattr(os, "scandir", second_refused)
        remove_unfinished(half_filled)
    assert is_unfinished(half_filled)
    remove_unfinished(half_filled)
    assert sorted(os.listdir(half_filled)) == ["x", "y"]


def test_the_next_writer_finishes_a_partly_filled_folder(half_filled):
    (half_filled / ".splatwire-0123456789ab.part" / "moving" / "a" / ".bashrc").touch()
    (half_filled / ".splatwire-0123456789ab.part" / "moving" / "a" / "z").symlink_to("/")
    (half_filled / ".splatwire-0123456789ab.part" / "moving" / "a" / "x").write_bytes(b"other")
    remove_unfinished(half_filled)
    assert {path.name: path.read_bytes() for path in half_filled.iterdir()} == {"x": b"first", "y": b"second"}
    assert not is_unfinished(half_filled)


def test_files_of_a_folder_are_replaced_together_and_the_last_one_marks_them_as_complete(tmp_path, monkeypatch):
    replace, moved, folder = os.replace, [], tmp_path / "a"

    def write(text):
        with atomic_files(folder, last="index") as new:
            for name in ("index", "z", "b"):
                (new / name).write_text(text)

    write("old")
    (folder / "mine").touch()
    with suppress(ZeroDivisionError), atomic_files(folder, last="index") as new:
        (new / "b").write_text("half")
        _ = 1 / 0
    assert (folder / "b").read_text() == "old"

    def recorded(path, to):
        moved.append((Path(to).name, (folder / "index").exists()))
        replace(path, to)

    monkeypatch.setattr(os, "replace", recorded)
    write("new")
    assert moved == [("b", False), ("z", False), ("index", False)]
    assert sorted(os.listdir(folder)) == ["b", "index", "mine", "z"]
    assert {(folder / name).read_text() for name in ("b", "index", "z")} == {"new"}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not remove the working directory")
def test_the_working_directory_can_be_the_output(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with atomic_output(".") as new:
        new.mkdir()
        (new / "x").touch()
    assert os.listdir() == ["x"]


def test_ctrl_c_while_a_temporary_folder_is_removed_leaves_none(tmp_path, monkeypatch):
    remove, calls = whole.shutil.rmtree, []

    def interrupted(path, **options):
        calls.append(path)
        if len(calls) == 1:
            raise KeyboardInterrupt
        remove(path, **options)

    monkeypatch.setattr(whole.shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt):
        atomic_write(tmp_path / "a", b"all")
    assert len(calls) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("name", ["same", "other"])
def test_next_writer_removes_leftovers_of_a_killed_writer(tmp_path, name):
    kill_a_writer(tmp_path / "same", signal.SIGKILL)
    assert len(hidden(tmp_path)) == 1
    atomic_write(tmp_path / name, b"whole")
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("inside", [False, True])
def test_leftovers_of_a_check_that_was_killed_are_removed(tmp_path, monkeypatch, inside):
    target = tmp_path / "a"
    target.mkdir()
    with monkeypatch.context() as patched:
        patched.setattr(whole.shutil, "rmtree", lambda *_, **__: None)
        check_writable(target, inside=inside)
    folder = target if inside else tmp_path
    assert len(hidden(folder)) == 1
    remove_unfinished(folder)
    assert not hidden(folder)


def test_workspaces_of_running_writers_are_kept(tmp_path):
    with atomic_output(tmp_path / "a") as new:
        new.write_bytes(b"a")
        other = threading.Thread(target=atomic_write, args=(tmp_path / "b", b"b"))
        other.start()
        other.join()
        remove_unfinished(tmp_path)
        assert new.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_folder_moved_aside_by_a_killed_writer_is_restored(tmp_path):
    """The writer was killed between two renames, so neither folder has the target name."""
    space = workspace(tmp_path)
    (space / "old" / "stream").mkdir(parents=True)
    (space / "old" / "stream" / "packet").touch()
    (space / "new" / "stream").mkdir(parents=True)
    remove_unfinished(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["stream"]
    assert [path.name for path in (tmp_path / "stream").iterdir()] == ["packet"]


def test_only_own_workspaces_are_removed(tmp_path):
    for name in (".splatwire-notes", ".hidden.part", "splatwire-x.part"):
        (tmp_path / name).mkdir()
    (tmp_path / "kept").mkdir()
    (tmp_path / ".splatwire-link.part").symlink_to(tmp_path / "kept")
    remove_unfinished(tmp_path)
    assert len(list(tmp_path.iterdir())) == 5


def test_links_in_a_workspace_are_not_followed(tmp_path):
    """An untrusted folder contains links with the names of a killed writer's workspace."""
    secret = tmp_path / "home" / ".ssh"
    secret.mkdir(parents=True)
    (secret / "id").write_bytes(b"key")
    clone = tmp_path / "clone"
    spaces = [workspace(clone, number) for number in range(4)]
    (spaces[0] / "old").symlink_to(tmp_path / "home")
    (spaces[1] / "old").mkdir()
    (spaces[1] / "old" / "b").symlink_to(secret)
    (spaces[2] / "old").mkdir()
    (spaces[2] / "old" / "c").symlink_to(secret / "id")
    (spaces[3] / "new").symlink_to(tmp_path / "home")
    (clone / ".splatwire-0123456789ab.part").symlink_to(tmp_path / "home")
    atomic_write(clone / "a", b"whole")
    assert (secret / "id").read_bytes() == b"key"
    assert not {".ssh", "b", "c", "id"} & {path.name for path in clone.iterdir()}


@pytest.mark.parametrize("mode", [0o700, 0o755, 0o750, 0o705])
@pytest.mark.parametrize(
    "inside",
    [["old/.git/config"], ["old/.GIT/config", "new/a/b"], ["old/.vscode/tasks.json"], ["old/a/b", "old/.git/c"],
     ["old/a/b", "old/c/d"], ["notes.txt"], ["old/a/b", "new/c/d", "other/e"], ["old/a/b", "new"]],
)  # fmt: skip
def test_foreign_folder_with_a_workspace_name_is_kept(tmp_path, inside, mode):
    space = workspace(tmp_path, mode=mode)
    for name in inside:
        (space / name).parent.mkdir(parents=True, exist_ok=True)
        (space / name).write_bytes(b"mine")
    atomic_write(tmp_path / "target", b"whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == [space.name, "target"]
    assert all((space / name).read_bytes() == b"mine" for name in inside)


@pytest.mark.parametrize("mode", [0o755, 0o775, 0o701])
def test_folder_readable_by_others_is_no_workspace(tmp_path, mode):
    """Version control systems and most archives create folders like this."""
    space = workspace(tmp_path, mode=mode)
    (space / "old" / "src").mkdir(parents=True)
    atomic_write(tmp_path / "target", b"whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == [space.name, "target"]


@pytest.mark.parametrize("name", [".splatwire-x.part", ".splatwire-0123456789AB.part", ".splatwire-0123456789ab.part "])
def test_foreign_names_are_kept(tmp_path, name):
    (tmp_path / name / "old" / "stream").mkdir(parents=True)
    atomic_write(tmp_path / "a", b"whole")
    assert (tmp_path / name / "old" / "stream").is_dir()
    assert not (tmp_path / "stream").exists()


def test_leftovers_of_other_users_are_kept(tmp_path, monkeypatch):
    (workspace(tmp_path) / "old" / "stream").mkdir(parents=True)
    monkeypatch.setattr(os, "geteuid", lambda: os.stat(tmp_path).st_uid + 1)
    remove_unfinished(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".splatwire-0123456789ab.part"]


def test_link_is_not_replaced_by_a_restored_folder(tmp_path):
    (workspace(tmp_path) / "old" / "stream").mkdir(parents=True)
    (tmp_path / "stream").symlink_to(tmp_path / "nowhere")
    remove_unfinished(tmp_path)
    assert (tmp_path / "stream").is_symlink()
    assert not (tmp_path / "nowhere").exists()


def test_folder_replaced_by_a_link_during_restore_is_not_followed(tmp_path, monkeypatch):
    (tmp_path / "home" / "old" / "secret").mkdir(parents=True)
    clone, locked = tmp_path / "clone", whole._lock
    space = workspace(clone)
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


def test_workspace_is_private_and_the_result_has_default_permissions(tmp_path):
    with atomic_output(tmp_path / "a") as new:
        assert (tmp_path / hidden(tmp_path)[0]).stat().st_mode & 0o777 == 0o700
        new.mkdir()
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o777 & ~_umask()


def _umask() -> int:
    before = os.umask(0)
    os.umask(before)
    return before


def test_workspace_removed_as_stale_is_recreated(tmp_path, monkeypatch):
    """Another process cleans up between creation and locking of the hidden folder."""
    lock, calls = whole._lock, []

    def late(handle):
        calls.append(handle)
        if len(calls) == 1:
            (tmp_path / hidden(tmp_path)[0]).rmdir()
        return lock(handle)

    monkeypatch.setattr(whole, "_lock", late)
    atomic_write(tmp_path / "a", b"whole")
    assert len(calls) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_workspace_deleted_before_locking_is_recreated(tmp_path, monkeypatch):
    opened, tried = os.open, []

    def too_late(path, flags, *rest, **more):
        if str(path).endswith(".part") and not tried:
            tried.append(path)
            os.rmdir(path)
        return opened(path, flags, *rest, **more)

    monkeypatch.setattr(os, "open", too_late)
    atomic_write(tmp_path / "a", b"1")
    assert tried
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_self_referencing_link_is_refused(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises((InvalidValueError, OSError)), atomic_output(tmp_path / "loop"):
        raise AssertionError
    assert os.readlink(tmp_path / "loop") == "loop"


def test_missing_parent_folders_are_created_only_on_request(tmp_path):
    for name in ("new/a", "x/y/a"):
        with pytest.raises(InvalidValueError, match="no such folder, so a cannot be written into it: make it first"):
            atomic_write(tmp_path / name, b"")
        with pytest.raises(InvalidValueError, match="no such folder"):
            check_writable(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_writable_output_is_detected_and_no_file_is_left(tmp_path):
    (tmp_path / "folder").mkdir()
    for name in ("new", "folder"):
        check_writable(tmp_path / name)
        check_writable(tmp_path / name, inside=True)
    assert [path.name for path in tmp_path.rglob("*")] == ["folder"]


def refuse(monkeypatch, folder, error=errno.EACCES):
    """Makes creating files in a folder fail, also for the superuser."""
    made = whole.Path.mkdir

    def mkdir(path, *rest, **more):
        if path.parent == folder:
            raise OSError(error, os.strerror(error), str(path))
        made(path, *rest, **more)

    monkeypatch.setattr(whole.Path, "mkdir", mkdir)


@pytest.mark.parametrize("error", [errno.EACCES, errno.EROFS, errno.EPERM, errno.ENOSPC])
def test_unwritable_output_is_detected_before_the_work(tmp_path, monkeypatch, error):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    refuse(monkeypatch, tmp_path, error)
    for name in ("new", "file", "folder"):
        with pytest.raises(InvalidValueError, match=f"nothing can be written into {tmp_path}: {os.strerror(error)}"):
            check_writable(tmp_path / name)
    check_writable(tmp_path / "folder", inside=True)
    for name in ("file/a", "file/a/b"):
        with pytest.raises(InvalidValueError, match="not a folder, so nothing"):
            check_writable(tmp_path / name)
    with pytest.raises(InvalidValueError, match="File name too long"):
        check_writable(tmp_path / "folder" / ("x" * 300))


def test_file_of_another_user_in_a_sticky_folder_is_detected_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "theirs").touch()
    tmp_path.chmod(0o1777)
    monkeypatch.setattr(os, "geteuid", lambda: os.stat(tmp_path).st_uid + 1)
    check_writable(tmp_path / "mine")
    with pytest.raises(InvalidValueError, match="is another user's and cannot be replaced"):
        check_writable(tmp_path / "theirs")
