"""Fallbacks for platforms that lack a system call, tested by removing the call."""

import os
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
from project import ROOT

from colmap_edges.cli.terminal import handled_signals
from colmap_edges.errors import NotAFileError
from colmap_edges.runtime import memory, platform
from colmap_edges.runtime.input_files import open_file
from colmap_edges.runtime.ownership import read_record


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
    assert set(handled_signals()) <= {signal.SIGINT, signal.SIGTERM}


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
        "print(platform.resource)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout == "None\n", done.stderr


def test_posix_calls_are_in_the_platform_module_only():
    posix = re.compile(
        r"^\s*import (fcntl|resource|pwd|grp)\b|O_NO\w+|/proc/|\bCDLL\b|geteuid", re.M
    )
    for path in (ROOT / "colmap_edges").rglob("*.py"):
        if path.name != "platform.py":
            assert not posix.search(path.read_text()), path
