"""Files appear whole or not at all, in the place of nothing but files that may be replaced."""

import os
from pathlib import Path

import pytest

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.output import write_whole

resource = pytest.importorskip("resource", reason="limits of file sizes are POSIX")


@pytest.fixture
def small_disk():
    """Files of at most 1000 bytes; writing more fails as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def refusal(path, *, overwrite=True, data=b"new"):
    """The message with which a file is refused."""
    with pytest.raises(ColmapEdgesError) as caught:
        write_whole(path, data, "edges", overwrite=overwrite)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_file_is_written_and_replaced(tmp_path):
    path = tmp_path / "a.ply"
    write_whole(path, b"one", "edges", overwrite=False)
    assert "a.ply exists already" in refusal(path, overwrite=False)
    assert path.read_bytes() == b"one"
    write_whole(path, b"two", "edges")
    assert path.read_bytes() == b"two"
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask()
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ply"]


def umask():
    found = os.umask(0)
    os.umask(found)
    return found


@pytest.mark.parametrize("target", ["missing.txt", "precious.txt"])
def test_links_are_not_followed(tmp_path, target):
    (tmp_path / "precious.txt").write_text("precious")
    path = tmp_path / "a.ply"
    path.symlink_to(tmp_path / target)
    assert "it is a link to" in refusal(path)
    assert "it is a link to" in refusal(path, overwrite=False)
    assert path.is_symlink() and not (tmp_path / "missing.txt").exists()
    assert (tmp_path / "precious.txt").read_text() == "precious"


def test_pipes_folders_and_devices_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    (tmp_path / "folder.ply").mkdir()
    assert "it is a pipe, not a file" in refusal(tmp_path / "pipe.ply")
    assert "it is a folder, not a file" in refusal(tmp_path / "folder.ply")
    assert "it is a device, not a file" in refusal(Path(os.devnull))
    assert (tmp_path / "pipe.ply").is_fifo()


@pytest.mark.parametrize("name", ["", "/", ".", "..", "a\0b.ply", f"{'a' * 300}.ply"])
def test_names_that_no_file_can_have(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert refusal(Path(name)).startswith("cannot write ")
    assert list(tmp_path.iterdir()) == []


def test_longest_names_are_written(tmp_path):
    write_whole(tmp_path / ("a" * 255), b"new", "edges")


def test_the_folder_must_exist(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in ("none", "file"):
        assert refusal(tmp_path / folder / "a.ply").startswith("cannot write ")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write")
def test_a_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    assert "Permission denied" in refusal(tmp_path / "a.ply")
    tmp_path.chmod(0o700)


def test_a_full_disk_leaves_the_earlier_file(tmp_path, small_disk):
    path = tmp_path / "a.ply"
    path.write_bytes(b"earlier")
    text = refusal(path, data=bytes(5000))
    assert text == f"cannot write the edges to {path}: File too large"
    assert path.read_bytes() == b"earlier"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ply"]


def test_errors_name_the_place_in_the_complete_output(tmp_path, small_disk):
    work = tmp_path / ".run.colmap-edges" / "new"
    work.mkdir(parents=True)
    text = refusal(work / "mesh.ply", data=bytes(5000))
    assert text == f"cannot write the edges to {tmp_path / 'run' / 'mesh.ply'}: File too large"
