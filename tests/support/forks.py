"""The process that parses MATLAB files, forked rather than started: a hundred times as quick, and as safe from crashes.

Lines on standard input name a file and one for the answer; lines on standard output hold the exit codes.
"""

from __future__ import annotations

import os
import resource
import sys

import scipy.io  # noqa: F401 - once for all forks

from replant.data.logs import matlab_process


def parse(source: str, answer: str) -> None:
    os.dup2(os.open(source, os.O_RDONLY), 0)
    os.dup2(os.open(answer, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
    sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
    matlab_process.main()
    sys.stdout.flush()


def main() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.argv[1:] = [str(2 << 30)]
    for line in iter(sys.stdin.readline, ""):
        source, answer = line.rstrip("\n").split("\t")
        child = os.fork()
        if child == 0:
            parse(source, answer)
            os._exit(0)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    main()
