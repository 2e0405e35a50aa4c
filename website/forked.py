"""Run the commands of the project, and Python, in copies of one process that has imported them.

A start of Python imports SymPy, CasADi and SciPy for a second, and the documents have a hundred commands. A server
imports them once. A folder holds programs of the commands' names, for the PATH of a shell: each sends its arguments,
its folder, its environment and its files to the server, which forks, and returns the exit status.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

COMMANDS = {"mbsgen": "mbsgen.cli", "mbsrun": "mbsrun.cli"}
ALSO = ("casadi", "matplotlib.pyplot", "mbsrun.optimal.control", "scipy.integrate", "sympy")  # imported where needed
SOCKET, PYTHON = "server", "run-python"
LONGEST = 1 << 20  # bytes of a request
CLIENT = """\
#!{python} -IS
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect({path!r})
    text = json.dumps([{name!r}, sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()
    socket.send_fds(server, [len(text).to_bytes(8, "big")], [0, 1, 2])
    server.sendall(text)
    sys.exit(int(server.recv(16) or b"1"))
"""


@contextlib.contextmanager
def serve(folder: Path) -> Iterator[Path]:
    """Start a server, and return the folder of the programs that call it."""
    path = folder / SOCKET
    for name in (*COMMANDS, PYTHON):
        program = folder / name
        program.write_text(CLIENT.format(python=sys.executable, path=str(path), name=name), encoding="utf-8")
        program.chmod(0o755)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        number = listener.fileno()
        server = subprocess.Popen([sys.executable, "-m", "website.forked", str(number)], pass_fds=[number])
        try:
            yield folder
        finally:
            server.kill()
            server.wait()


def main(number: int) -> None:
    """Answer requests at the socket of this number, each in a copy of this process."""
    for module in (*COMMANDS.values(), *ALSO):
        importlib.import_module(module)
    for module in COMMANDS.values():
        list(importlib.import_module(module).cli.commands.values())  # loads them
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the answering copies leave no zombies
    with socket.socket(fileno=number) as listener:
        while True:
            asked, _ = listener.accept()
            if os.fork() == 0:
                listener.close()
                break
            asked.close()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    begun, files, _, _ = socket.recv_fds(asked, 8, 3)
    with asked.makefile("rb") as stream:
        name, arguments, folder, variables = json.loads(stream.read(int.from_bytes(begun, "big")))
    worker = os.fork()
    if worker:
        status = os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1])
        asked.sendall(str(status if status >= 0 else 128 - status).encode())
        os._exit(0)
    asked.close()
    for target, file in enumerate(files):
        os.dup2(file, target)
        os.close(file)
    sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115  # the process ends them
    sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    _run(name, arguments)


def _run(name: str, arguments: list[str]) -> None:
    """Run a command as its entry point does, or Python's text as `python -c` does."""
    if name == PYTHON:
        (text,) = arguments
        sys.argv, sys.path[0] = ["-c"], ""
        exec(compile(text, "<string>", "exec"), {"__name__": "__main__"})  # noqa: S102  # the project's own documents
        return
    sys.argv = [name, *arguments]
    sys.exit(importlib.import_module(COMMANDS[name]).main())


if __name__ == "__main__":
    main(int(sys.argv[1]))
