"""The command line and the scripts, run in forks of a process that has imported their libraries.

A call takes the time of its work, not that of starting Python and importing libraries.
"""

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

COMMAND = "colmap-edges"
SERVER = f"""
import contextlib, gc, importlib, json, os, pkgutil, resource, runpy, signal, sys
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command sets it, before numpy is loaded
import colmap_edges
from colmap_edges.cli.main import main
for module in pkgutil.walk_packages(colmap_edges.__path__, "colmap_edges."):
    with contextlib.suppress(ImportError):  # of extras
        module.name.endswith("__main__") or importlib.import_module(module.name)
gc.freeze()
for line in sys.stdin:
    request = json.loads(line)
    if "wait" in request:
        ended, status = os.waitpid(request["wait"], request["flags"])
        print(os.waitstatus_to_exitcode(status) if ended else "null", flush=True)
        continue
    child = os.fork()
    if child:
        print(child, flush=True)
        continue
    for stream, path in enumerate(request["files"]):
        os.dup2(os.open(path, os.O_RDWR), stream)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["variables"])
    ignored = request["hangup_ignored"]
    signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where jobs ignore it
    if request["file_size"]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (request["file_size"],) * 2)
    if request["num_processes"]:
        resource.setrlimit(resource.RLIMIT_NPROC, (request["num_processes"],) * 2)
    if request["user"]:
        os.setgroups([])
        os.setresgid(*[request["user"][1]] * 3)
        os.setresuid(*[request["user"][0]] * 3)
    program, *words = request["words"]
    if program == {COMMAND!r}:
        main(words)
    sys.argv = request["words"]
    sys.path.insert(0, os.path.dirname(program))
    runpy.run_path(program, run_name="__main__")
    sys.exit()
"""


@cache
def server():
    """The process that is forked; it ends with this one.

    It starts where PYTHONPATH may be relative to, whatever folder the first test is in.
    """
    folder = Path(__file__).resolve().parents[2]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-c", SERVER], text=True, cwd=folder, **pipes)
    atexit.register(process.communicate)
    return process


def ask(request, timeout=120):
    """Ask the server to start a program or to wait for one; the id, exit code or None."""
    server().stdin.write(json.dumps(request) + "\n")
    server().stdin.flush()
    if not select.select([server().stdout], [], [], timeout)[0]:
        server().kill()
        server.cache_clear()
        raise subprocess.TimeoutExpired(str(request), timeout)
    return json.loads(server().stdout.readline())


class Forked:
    """A run of a program in a fork, used like `subprocess.Popen` with text captured."""

    def __init__(
        self,
        program,
        *words,
        file_size=0,
        user=None,
        num_processes=0,
        hangup_ignored=False,
        **environment,
    ):
        """Start a script, or the command line as `COMMAND`.

        Args:
            program: path of the script, or `COMMAND`.
            words: its arguments.
            file_size: limit of the size of files, bytes.
            user: ids of another user and group.
            num_processes: limit of the user's processes and threads, which root does not have.
            hangup_ignored: whether SIGHUP is ignored, as nohup has it.
            environment: further variables.
        """
        self.folder = tempfile.TemporaryDirectory()
        files = [os.devnull, *(str(Path(self.folder.name, name)) for name in ("out", "err"))]
        for path in files[1:]:
            Path(path).touch()
        self.files, self.returncode = files, None
        request = {"words": [os.fspath(program), *map(str, words)], "files": files}
        request |= {"folder": str(Path.cwd()), "variables": dict(os.environ) | environment}
        how = {"file_size": file_size, "user": user, "hangup_ignored": hangup_ignored}
        how["num_processes"] = num_processes
        self.pid = ask(request | how)

    def poll(self, flags=os.WNOHANG, timeout=120):
        """The exit code, None while it runs."""
        if self.returncode is None:
            self.returncode = ask({"wait": self.pid, "flags": flags}, timeout)
        return self.returncode

    def wait(self, timeout=120):
        """Wait for the end; the exit code."""
        return self.poll(0, timeout)

    def communicate(self, timeout=120):
        """Wait for the end; what was written to standard output and error."""
        self.wait(timeout)
        with self.folder:
            return tuple(Path(path).read_text() for path in self.files[1:])

    def send_signal(self, number):
        """Send a signal unless it has ended; its id stays taken until it is waited for."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def call_forked(words, timeout=120, program=COMMAND, **how):
    """What `subprocess.run` gives of `colmap-edges` with these words, text captured."""
    process = Forked(program, *map(os.fspath, words), **how)
    output, errors = process.communicate(timeout)
    return subprocess.CompletedProcess(words, process.returncode, output, errors)
