import errno
import os
import stat

import pytest

from quadwalk.errors import UserError
from quadwalk.files import open_atomic


def test_the_file_appears_when_the_block_ends(tmp_path):
    path = tmp_path / "a"
    with open_atomic(path) as file:
        file.write(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_what_breaks_the_block_leaves_the_old_file(tmp_path, error):
    path = tmp_path / "a"
    path.write_bytes(b"old")

    def break_off(file):
        file.write(b"half")
        raise error

    with pytest.raises(error), open_atomic(path) as file:
        break_off(file)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_what_the_system_refuses_is_one_line(tmp_path, monkeypatch, call):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "a"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, call, full)
    with pytest.raises(UserError) as caught, open_atomic(path) as file:
        file.write(b"new")
    monkeypatch.undo()
    assert str(caught.value) == f"cannot write {path}: No space left on device"
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a"]


def test_a_folder_that_is_not_there_or_in_the_way_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none/a: No such file or directory"):
        open_atomic(tmp_path / "none" / "a").__enter__()
    with pytest.raises(UserError, match=r"^cannot write .*: Is a directory$"):
        open_atomic(tmp_path).__enter__()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_takes_no_file_is_named(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(UserError, match="Permission denied"):
        open_atomic(tmp_path / "locked" / "a").__enter__()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_really_full_device(tmp_path):
    os.symlink("/dev/full", tmp_path / "a.part")
    with pytest.raises(UserError, match="No space left"), open_atomic(tmp_path / "a") as file:
        file.write(b"new")
    assert os.listdir(tmp_path) == []


def test_a_link_stays_and_leads_to_what_is_written(tmp_path):
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link"
    link.symlink_to("folder/a")
    for content in (b"new", b"newer"):  # at first it leads nowhere
        with open_atomic(link) as file:
            file.write(content)
        assert (tmp_path / "folder" / "a").read_bytes() == content
    assert link.is_symlink()
    assert os.listdir(tmp_path / "folder") == ["a"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs POSIX's files")
@pytest.mark.parametrize("linked", [False, True])
def test_what_is_no_regular_file_is_written_as_it_is(tmp_path, linked):
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    with open(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb") as reader:
        with open_atomic(link if linked else pipe) as file:
            file.write(b"new")
        assert reader.read() == b"new"
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert link.is_symlink()
    assert sorted(os.listdir(tmp_path)) == ["link", "pipe"]
