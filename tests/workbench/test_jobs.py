"""The worker process of the page: its errors are reported here, and its death ends nothing else."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator

import pytest

from replant.errors import ReplantError
from replant.workbench.tasks import Work
from support.waiting import PATIENCE


@pytest.fixture
def work() -> Iterator[Work]:
    made = Work()
    yield made
    made.close()


def test_one_process_does_one_thing_after_the_other(work: Work) -> None:
    assert work.do(os.getpid) == work.do(os.getpid) != os.getpid()


def test_an_error_comes_back_with_where_it_was_raised(work: Work) -> None:
    with pytest.raises(ValueError, match="invalid literal") as found:
        work.do(int, "two")
    assert "Traceback" in str(found.value.__cause__)


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system has no signal masks")
def test_ctrl_c_is_for_the_server_alone_from_the_first_instruction_on(work: Work) -> None:
    assert signal.SIGINT in work.do(signal.pthread_sigmask, signal.SIG_BLOCK, ())


def test_a_process_that_dies_is_told_and_replaced(work: Work) -> None:
    first = work.do(os.getpid)
    with pytest.raises(ReplantError, match="the process that computes this has died"):
        work.do(os._exit, 1)
    assert work.do(os.getpid) != first


def test_closing_ends_what_is_being_computed(work: Work) -> None:
    work.do(os.getpid)
    told = []

    def wait() -> None:
        try:
            work.do(time.sleep, 10 * PATIENCE)
        except ReplantError as error:
            told.append(str(error))

    waiting = threading.Thread(target=wait)
    waiting.start()
    work.close()
    waiting.join(PATIENCE)
    assert not waiting.is_alive()
    assert told
