"""The command line, called in forks of a process that has imported all it needs.

A call takes the time of its work, not that of starting Python and importing libraries.
"""

import atexit
import json
import os
import select
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

SERVER = """
import json, os, sys
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command sets it, before numpy is loaded
import colmap_edges.cli.run_commands, colmap_edges.pipeline.run, colmap_edges.evaluation.run
import colmap_edges.edges3d.chains.tracing, colmap_edges.surfaces.mesher
from colmap_edges.cli.main import main
for line in sys.stdin:
    words, files, folder, variables = json.loads(line)
    child = os.fork()
    if not child:
        for stream, path in enumerate(files):
            os.dup2(os.open(path, os.O_RDWR), stream)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(variables)
        main(words)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@cache
def server():
    """The process that is forked; it ends with this one."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-c", SERVER], text=True, **pipes)
    atexit.register(process.communicate)
    return process


def call_forked(words, timeout=120):
    """What `subprocess.run` gives of `colmap-edges` with these words, text captured."""
    with tempfile.TemporaryDirectory() as folder:
        output, errors = Path(folder, "output"), Path(folder, "errors")
        output.touch()
        errors.touch()
        files = [os.devnull, str(output), str(errors)]
        words = [os.fspath(word) for word in words]
        request = json.dumps([words, files, str(Path.cwd()), dict(os.environ)])
        server().stdin.write(request + "\n")
        server().stdin.flush()
        if not select.select([server().stdout], [], [], timeout)[0]:
            server().kill()
            server.cache_clear()
            raise subprocess.TimeoutExpired(words, timeout)
        code = int(server().stdout.readline())
        return subprocess.CompletedProcess(words, code, output.read_text(), errors.read_text())
