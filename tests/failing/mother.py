"""A process that has imported all that a live session needs, and forks one session after the other.

    LD_PRELOAD=failing.so FAILING_PAGE=page python mother.py page

Takes one JSON object a line on standard input, what to run and which call is to fail, and answers with one on standard
output.  Forked sessions run `replant.cli.main` as ``python -m replant`` does, to the interpreter's own end; the calls
that count are those after the fork.
"""

from __future__ import annotations

import ctypes
import gc
import io
import json
import mmap
import multiprocessing
import os
import signal
import socket
import struct
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

KINDS = ("open", "write", "send", "read", "sync", "rename", "socket", "fork", "alloc", "wait")
ROLES = ("none", "session", "observer")
COUNTS = struct.Struct(f"{len(ROLES) * len(KINDS)}q")
FIRED = struct.Struct("q")
PLAN = struct.Struct("6q64s")  # role, kind, nth, error, lasting, least; the name of the call that failed
SIZE = 8192
GRACE = 60.0  # s that what a session began may take to notice its end, as Python's own helper does


def play(role: str) -> None:
    """Have this process count its calls, as one of `ROLES`."""
    preloaded: Any = ctypes.CDLL(None)
    if hasattr(preloaded, "failing_role"):
        preloaded.failing_role(ROLES.index(role))


if __name__ == "__mp_main__":  # the observer of a session, begun as a process of its own
    import replant.live.judge_process  # noqa: F401 - before the calls count

    play("observer")


class Page:
    """The page of memory that all processes of a case share."""

    def __init__(self, path: str) -> None:
        with Path(path).open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), SIZE)

    def order(self, fault: dict[str, Any] | None) -> None:
        """Begin a new count, and say what is to fail."""
        COUNTS.pack_into(self._memory, 0, *[0] * len(ROLES) * len(KINDS))
        FIRED.pack_into(self._memory, COUNTS.size, 0)
        plan = (0, 0, 0, 0, 0, 0)
        if fault is not None:
            plan = (
                ROLES.index(fault["role"]), KINDS.index(fault["kind"]), fault["nth"], fault["error"],
                int(fault["lasting"]), fault["least"],
            )  # fmt: skip
        PLAN.pack_into(self._memory, COUNTS.size + FIRED.size, *plan, b"")

    def read(self) -> dict[str, Any]:
        """Return the counts, how many calls failed, and the name of the first."""
        counts = COUNTS.unpack_from(self._memory, 0)
        (fired,) = FIRED.unpack_from(self._memory, COUNTS.size)
        name = PLAN.unpack_from(self._memory, COUNTS.size + FIRED.size)[-1]
        table = {
            role: dict(zip(KINDS, counts[k * len(KINDS) : (k + 1) * len(KINDS)], strict=True))
            for k, role in enumerate(ROLES)
        }
        return {"counts": table, "fired": fired, "call": name.rstrip(b"\0").decode()}


def prepare(model: list[str]) -> None:
    """Import what a session, its observer and its dashboard need."""
    import pyarrow.compute
    import pyarrow.parquet
    import rich.console
    import rich.live
    import rich.padding
    import rich.table
    import uvicorn.loops.asyncio
    import uvicorn.protocols.http.auto
    import uvicorn.protocols.websockets.websockets_sansio_impl  # noqa: F401

    import replant.cli.live
    import replant.live.dashboard.app
    import replant.live.dashboard.server
    import replant.logs.csv
    import replant.logs.read
    from replant import Identifier
    from replant.live.make_view import EstimateHistory, make_view
    from replant.live.streams import UY, addresses, serial_and_network
    from replant.live.view import SessionInfo

    context = replant.cli.live.live_command.make_context("live", ["-", *model])
    request = replant.cli.live._request(context.params)
    identifier = Identifier(**vars(request))
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 150), 8)
    identifier.update_many(u, np.convolve(u, 0.1 * 0.9 ** np.arange(100))[: u.size])
    identifier.assess()
    view = make_view(
        identifier, SessionInfo(0.0, "", "connected", {}, 0.0, 0.0), EstimateHistory(identifier.structure.size)
    )
    rich.console.Console(file=io.StringIO()).print(replant.live.terminal_status.render(view))
    pyarrow.parquet.write_table(pyarrow.table({"words": pyarrow.array(["once"])}), io.BytesIO())  # imports pandas
    rig = serial_and_network.TcpSource(addresses.Address("", "tcp", "127.0.0.1", 1), None, UY)
    socket.getaddrinfo("127.0.0.1", rig._place[1])


def session(case: dict[str, Any]) -> None:
    """Run a session in this process, which was forked for it."""
    os.setpgid(0, 0)
    for number, name, flags in ((0, "stdin", os.O_RDONLY), (1, "stdout", os.O_WRONLY), (2, "stderr", os.O_WRONLY)):
        file = os.open(case[name], flags)
        os.dup2(file, number)
        os.close(file)
    import replant.live.judge_client
    import replant.live.session
    from replant.cli import main

    if case["fork"]:  # a spawned observer imports everything anew, which takes seconds
        begin, context = replant.live.judge_client.observe, multiprocessing.get_context("fork")
        multiprocessing.get_context = lambda method=None: context  # type: ignore[assignment]

        def observe(*arguments: Any) -> None:
            play("observer")
            begin(*arguments)

        replant.live.judge_client.observe = observe
    sys.argv = ["replant", *case["arguments"]]
    play("session")
    main()


def wait(process: int, limit: float) -> int | None:
    """Return the status in which a process ended; None where it had to be killed."""
    deadline = time.monotonic() + limit
    while time.monotonic() < deadline:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return status
        time.sleep(0.005)
    os.kill(process, signal.SIGABRT)  # faulthandler says where it hangs
    time.sleep(0.5)
    os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return None


def is_left(group: int) -> bool:
    """Return whether a process of the group has not ended soon after the session; it is killed then."""
    deadline = time.monotonic() + GRACE
    try:
        while time.monotonic() < deadline:
            os.killpg(group, 0)
            time.sleep(0.005)
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def serve(page: Page) -> dict[str, Any] | None:
    """Answer cases one after the other; return one in the process that is to run it, None in the end."""
    for line in sys.stdin:
        case = json.loads(line)
        page.order(case["fault"])
        sys.stdout.flush()
        begun = time.monotonic()
        process = os.fork()
        if process == 0:
            return case
        status = wait(process, case["limit"])
        answer = page.read() | {
            "left": is_left(process),
            "seconds": time.monotonic() - begun,
            "code": None,
            "signal": None,
        }
        if status is not None and os.WIFSIGNALED(status):
            answer["signal"] = os.WTERMSIG(status)
        elif status is not None:
            answer["code"] = os.WEXITSTATUS(status)
        print(json.dumps(answer), flush=True)
    return None


if __name__ == "__main__":
    import faulthandler
    from multiprocessing import resource_tracker

    faulthandler.enable()
    prepare(sys.argv[2:])
    resource_tracker.ensure_running()
    gc.collect()
    gc.freeze()  # forked processes need not look through it again
    shared = Page(sys.argv[1])
    print("{}", flush=True)
    given = serve(shared)
    if given is not None:
        faulthandler.enable()
        session(given)
