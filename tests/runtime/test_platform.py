"""Fallbacks for platforms that lack a system call, tested by removing the call."""

import json
import os
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
from project import ROOT

from colmap_edges.cli.terminal import heeded_signals
from colmap_edges.errors import ColmapEdgesError, NotAFileError
from colmap_edges.runtime import memory, ownership, platform
from colmap_edges.runtime.input_files import open_file
from colmap_edges.runtime.output import new_folder
from colmap_edges.runtime.ownership import OUTPUT, file_sizes, read_record


def record(folder):
    report = {"versions": {"colmap-edges": "1"}, "files": file_sizes(folder)}
    (folder / "report.json").write_text(json.dumps(report))


def test_c_library_that_cannot_be_asked(monkeypatch):
    def refuse(_name):
        raise TypeError("no handle")

    monkeypatch.setattr(platform.ctypes, "CDLL", refuse)
    assert platform.c_function("mallopt") is None
    memory.reuse_freed_memory()
    memory.return_freed_memory()


def test_signals_that_there_are_not(monkeypatch):
    monkeypatch.delattr(signal, "SIGHUP", raising=False)
    assert platform.ending_signals() == [signal.SIGINT, signal.SIGTERM]
    assert set(heeded_signals()) <= {signal.SIGINT, signal.SIGTERM}


def test_links_are_refused_without_o_nofollow(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("{}")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC"):
        monkeypatch.delattr(os, name, raising=False)
    assert read_record(tmp_path / "file") == {}
    with pytest.raises(ValueError, match="symbolic links"):
        read_record(tmp_path / "link")
    with open_file(tmp_path / "link") as file:
        assert file.read() == b"{}"
    with pytest.raises(NotAFileError, match="is a folder"):
        open_file(tmp_path)


def test_all_files_are_ours_without_owners(monkeypatch, tmp_path):
    status = tmp_path.stat()
    foreign = SimpleNamespace(st_uid=status.st_uid + 1)
    assert platform.is_own(status)
    assert not platform.is_own(foreign)
    monkeypatch.delattr(os, "geteuid")
    assert platform.is_own(foreign)


class Msvcrt:
    """Windows' locks of bytes, kept in a table."""

    LK_NBLCK = 2

    def __init__(self):
        self.held = {}

    def locking(self, descriptor, mode, count):
        assert (mode, count) == (self.LK_NBLCK, 1)
        assert os.lseek(descriptor, 0, os.SEEK_CUR) > 1000  # not what others read
        inode = os.fstat(descriptor).st_ino
        if self.held.get(inode, descriptor) != descriptor:
            raise PermissionError(13, "Permission denied")
        self.held[inode] = descriptor


@pytest.fixture
def windows(monkeypatch):
    """Locks of Windows, where no open file can be removed either."""
    locks = Msvcrt()
    monkeypatch.setattr(platform, "fcntl", None)
    monkeypatch.setattr(platform, "msvcrt", locks)
    monkeypatch.setattr(platform, "removes_open_files", lambda: False)
    return locks


def test_windows_locks_keep_a_second_run_out(windows, tmp_path):
    first = platform.make_own(tmp_path / "lock")
    os.write(first, b"text")
    platform.lock(first)
    second = platform.open_plain(tmp_path / "lock", os.O_RDWR, follow=False)
    with pytest.raises(BlockingIOError):
        platform.try_lock(second)
    assert os.read(second, 10) == b"text"  # its place is where it was
    windows.held.clear()
    platform.try_lock(second)
    os.close(first)
    os.close(second)


def test_waiting_for_a_windows_lock(windows, tmp_path, monkeypatch):
    first = platform.make_own(tmp_path / "lock")
    platform.lock(first)
    second = platform.open_plain(tmp_path / "lock", os.O_RDWR, follow=False)
    monkeypatch.setattr(platform.time, "sleep", lambda _: windows.held.clear())
    platform.lock(second)
    assert list(windows.held.values()) == [second]
    os.close(first)
    os.close(second)


def test_output_appears_with_windows_locks(windows, tmp_path, monkeypatch):
    """And every lock is closed before its file is removed."""
    opened = {}
    make, close, unlink = platform.make_own, os.close, type(tmp_path).unlink

    def remember(path):
        opened[descriptor := make(path)] = path
        return descriptor

    def forget(descriptor):
        opened.pop(descriptor, None)
        close(descriptor)

    def check(path, **how):
        assert path not in opened.values(), "Windows would not remove a file that is open"
        unlink(path, **how)

    monkeypatch.setattr(platform, "make_own", remember)
    monkeypatch.setattr(os, "close", forget)
    monkeypatch.setattr(type(tmp_path), "unlink", check)
    for text in ("first", "second"):
        with new_folder(tmp_path / "out", OUTPUT, overwrite=text == "second") as folder:
            (folder / "edges.ply").write_text(text)
            record(folder)
            with (
                pytest.raises(ColmapEdgesError, match="another run is writing"),
                new_folder(tmp_path / "out", OUTPUT, overwrite=True),
            ):
                pass
        windows.held.clear()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "edges.ply").read_text() == "second"


def test_leftovers_of_a_killed_run_are_removed_on_windows(windows, tmp_path):
    left = tmp_path / f".out.colmap-edges-{'a' * 32}"
    (left / "new").mkdir(parents=True)
    (left / "lock").write_text(f"colmap-edges {'a' * 32}\n")
    with new_folder(tmp_path / "out") as folder:
        record(folder)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_neither_kind_of_lock(monkeypatch, tmp_path):
    monkeypatch.setattr(platform, "fcntl", None)
    monkeypatch.setattr(platform, "msvcrt", None)
    with new_folder(tmp_path / "out") as folder:
        record(folder)
    assert (tmp_path / "out" / "report.json").is_file()


@pytest.mark.parametrize("module", ["resource", None])
def test_peak_memory_without_proc(monkeypatch, module):
    def refuse(self, *_):
        raise FileNotFoundError(str(self))

    usual = platform.peak_memory_mb()
    monkeypatch.setattr(platform.Path, "read_text", refuse)
    monkeypatch.setattr(platform.Path, "write_text", refuse)
    platform.reset_peak_memory()
    if module is None:
        monkeypatch.setattr(platform, "resource", None)
        assert platform.peak_memory_mb() == 0
        return
    if sys.platform.startswith("linux"):
        assert platform.peak_memory_mb() > 0.5 * usual
    used = platform.peak_memory_mb()
    monkeypatch.setattr(sys, "platform", "darwin")  # which counts bytes, not kilobytes
    assert platform.peak_memory_mb() == pytest.approx(used / 1000, rel=0.2)


def test_package_starts_without_modules_of_posix():
    script = (
        "import sys\n"
        "for name in ('fcntl', 'resource', 'pwd', 'grp', 'termios'): sys.modules[name] = None\n"
        "import colmap_edges.cli.main, colmap_edges.pipeline.run\n"
        "from colmap_edges.runtime import platform\n"
        "print(platform.fcntl, platform.resource)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout == "None None\n", done.stderr


def test_posix_calls_are_in_the_platform_module_only():
    posix = re.compile(
        r"^\s*import (fcntl|resource|pwd|grp)\b|O_NO\w+|/proc/|\bCDLL\b|geteuid", re.M
    )
    for path in (ROOT / "colmap_edges").rglob("*.py"):
        if path.name != "platform.py":
            assert not posix.search(path.read_text()), path
    assert ownership.read_record is read_record
