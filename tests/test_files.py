"""Files that appear whole under their name, or not at all."""

import errno
import os

import pytest

from quadwalk.errors import UserError
from quadwalk.files import open_atomic


def write(path, content: bytes = b"new", error: type[BaseException] | None = None) -> None:
    """Write `content` to `path`, and raise `error` in the middle of it if there is one."""
    with open_atomic(path) as file:
        file.write(content)
        if error:
            raise error


@pytest.mark.parametrize("error", [None, KeyboardInterrupt, ValueError])
def test_the_new_content_takes_the_place_of_the_old_at_the_end_or_never(tmp_path, error):
    path = tmp_path / "a"
    path.write_bytes(b"old")
    if error is None:
        write(path)
    else:
        with pytest.raises(error):
            write(path, error=error)
    assert path.read_bytes() == (b"old" if error else b"new")
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_refusal_of_the_system_is_one_line(tmp_path, monkeypatch, call):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "a"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(UserError) as caught:
        write(path)
    assert str(caught.value) == f"cannot write {path}: No space left on device"
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a"]


def test_a_place_that_takes_no_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none/a: No such file or directory"):
        write(tmp_path / "none" / "a")
    with pytest.raises(UserError, match=r"^cannot write .*: Is a directory$"):
        write(tmp_path)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_really_full_device(tmp_path):
    os.symlink("/dev/full", tmp_path / "a.part")
    with pytest.raises(UserError, match="No space left"):
        write(tmp_path / "a")
    assert os.listdir(tmp_path) == []


def test_a_link_stays_and_its_target_is_written(tmp_path):
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link"
    link.symlink_to("folder/a")
    for content in (b"new", b"newer"):  # at first it leads nowhere
        write(link, content)
        assert (tmp_path / "folder" / "a").read_bytes() == content
    assert link.is_symlink()
    assert os.listdir(tmp_path / "folder") == ["a"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs POSIX's files")
@pytest.mark.parametrize("name", ["pipe", "link"])
def test_a_pipe_is_written_as_it_is(tmp_path, name):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    with open(os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK), "rb") as reader:
        write(tmp_path / name)
        assert reader.read() == b"new"
    assert (tmp_path / "link").is_symlink()
    assert sorted(os.listdir(tmp_path)) == ["link", "pipe"]
