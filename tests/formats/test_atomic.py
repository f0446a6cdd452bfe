"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest
from shapes import box

from vhp_cli.errors import UnreadableFileError, VhpError
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.formats.atomic import atomic_write_bytes, atomic_write_text, make_directory, write_atomically


def test_contents_and_permissions(tmp_path):
    path = tmp_path / "a.bin"
    atomic_write_bytes(path, b"one")
    atomic_write_bytes(path, b"two\r\n")
    assert path.read_bytes() == b"two\r\n"
    write_atomically(path, lambda file: (file.write(b"th"), file.write(b"ree")))
    assert path.read_bytes() == b"three"
    atomic_write_text(path, "µm\n")
    assert path.read_bytes() == "µm\n".encode()
    assert list(tmp_path.iterdir()) == [path]
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


def refuse(*_args, **_options):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("step", ["write", "fsync", "replace", "open"])
@pytest.mark.parametrize("existing", [True, False])
def test_a_full_disk_leaves_everything_as_it_was(tmp_path, monkeypatch, step, existing):
    path = tmp_path / "a.bin"
    if existing:
        path.write_bytes(b"old")
    data = b"new"
    if step == "write":
        data = refuse
    elif step == "replace":
        monkeypatch.setattr(Path, "replace", refuse)
    else:
        monkeypatch.setattr(os, step, refuse)
    with pytest.raises(VhpError, match="No space left") as caught:
        write_atomically(path, data)
    assert str(path) in caught.value.message
    assert caught.value.hint
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == ([path] if existing else [])
    assert not existing or path.read_bytes() == b"old"


def test_any_exception_removes_the_temporary_file(tmp_path):
    def write_half(file):
        file.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.bin", write_half)
    assert list(tmp_path.iterdir()) == []


def test_the_final_name_appears_after_the_flush(tmp_path, monkeypatch):
    path, seen = tmp_path / "a.bin", []
    flush = os.fsync
    monkeypatch.setattr(os, "fsync", lambda descriptor: (seen.append(path.exists()), flush(descriptor)))
    atomic_write_bytes(path, b"x")
    assert seen[0] is False
    assert seen[1:] == ([True] if os.name == "posix" else [])  # the directory, after the rename


def test_directories_that_cannot_be_written(tmp_path):
    with pytest.raises(VhpError, match="No such file"):
        write_mesh(tmp_path / "missing" / "a.stl", box())
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(VhpError, match="Not a directory"):
        write_mesh(tmp_path / "file" / "a.stl", box())
    (tmp_path / "a.stl").mkdir()
    with pytest.raises(VhpError, match=r"directory"):
        write_mesh(tmp_path / "a.stl", box())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.stl", "file"]


def test_make_directory(tmp_path):
    make_directory(tmp_path / "a" / "b")
    make_directory(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(VhpError, match=r"can't write .*file"):
        make_directory(tmp_path / "file" / "b")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_read_only_directory(tmp_path):
    tmp_path.chmod(0o555)
    try:
        with pytest.raises(VhpError, match="Permission denied"):
            write_mesh(tmp_path / "a.stl", box())
    finally:
        tmp_path.chmod(0o755)


def test_long_names(tmp_path):
    path = tmp_path / ("x" * 250 + ".stl")
    write_mesh(path, box())
    assert len(read_mesh(path).mesh.faces) == 12


def test_unknown_suffixes(tmp_path):
    with pytest.raises(VhpError, match=r"\.off"):
        write_mesh(tmp_path / "a.off", box())
    (tmp_path / "a").write_bytes(b"")
    with pytest.raises(UnreadableFileError, match="suffix"):
        read_mesh(tmp_path / "a")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(UnreadableFileError, match="No such file") as caught:
        read_mesh(tmp_path / "a.stl")
    assert caught.value.path == tmp_path / "a.stl"
    (tmp_path / "b.stl").mkdir()
    with pytest.raises(UnreadableFileError, match="directory"):
        read_mesh(tmp_path / "b.stl")
