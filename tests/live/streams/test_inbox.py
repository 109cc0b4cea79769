"""The queue between reader and session: ordered, bounded, and without loss if the sender can wait."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replant.live.streams.addresses import Address
from replant.live.streams.reader_thread import BACKOFF, LARGEST_BATCH, Inbox
from replant.live.streams.serial_and_network import Wire
from replant.live.streams.source import UY, Batch
from support.cases import examples
from support.waiting import PATIENCE


def batch_of(first: int, count: int, arrived: float = 0.0) -> Batch:
    values = np.arange(first, first + count, dtype=float)
    return Batch(values, -values, values / 8, values.astype(np.int64), arrived)


@settings(derandomize=True, max_examples=examples(200), deadline=None)
@given(st.lists(st.integers(0, 12) | st.just(-1), max_size=40), st.integers(1, 10))
def test_the_newest_stay_in_order_and_the_rest_is_counted(steps: list[int], capacity: int) -> None:
    """Compare with a plain list; -1 takes samples, another number puts that many."""
    inbox, model, put, dropped, expected = Inbox(capacity, drop=True), [], 0, 0, 0
    for step in steps:
        if step >= 0:
            dropped += inbox.put(batch_of(put, step))
            model += range(put, put + step)
            put += step
            expected += max(len(model) - capacity, 0)
            model = model[-capacity:]
            assert len(inbox) == len(model)
        else:
            while model:
                batch = inbox.get(0.0)
                assert batch.sequence is not None
                assert batch.t is not None
                assert batch.sequence.tolist() == model[: len(batch)]
                assert batch.u.tolist() == (-batch.y).tolist() == (8 * batch.t).tolist() == model[: len(batch)]
                model = model[len(batch) :]
            assert not len(inbox.get(0.0))
        assert dropped == expected


def test_a_full_queue_makes_the_reader_wait_and_nothing_is_lost() -> None:
    inbox = Inbox(7, drop=False)
    counts = [1, 20, 3, 0, 7, 8]

    def fill() -> None:
        first = 0
        for count in counts:
            assert inbox.put(batch_of(first, count)) == 0
            first += count
        inbox.end()

    reader = threading.Thread(target=fill, daemon=True)
    reader.start()
    taken: list[int] = []
    while not inbox.ended or len(inbox):
        batch = inbox.get(PATIENCE)
        assert len(batch) <= 7
        taken += batch.u.astype(int).tolist()
    reader.join(PATIENCE)
    assert taken == list(range(sum(counts)))


def test_a_reader_that_waits_goes_on_when_nobody_takes_any_more() -> None:
    inbox = Inbox(1, drop=False)
    reader = threading.Thread(target=inbox.put, args=[batch_of(0, 5)], daemon=True)
    reader.start()
    inbox.abandon()
    reader.join(PATIENCE)
    assert not reader.is_alive()


def test_what_came_in_piecemeal_goes_out_together_with_the_newest_arrival() -> None:
    inbox = Inbox(100, drop=True)
    for k in range(5):
        inbox.put(batch_of(k, 1, arrived=float(k)))
    batch = inbox.get(0.0)
    assert (len(batch), batch.arrived) == (5, 4.0)


def test_batches_are_bounded() -> None:
    inbox = Inbox(3 * LARGEST_BATCH, drop=True)
    inbox.put(batch_of(0, 2 * LARGEST_BATCH))
    assert [len(inbox.get(0.0)) for _ in range(3)] == [LARGEST_BATCH, LARGEST_BATCH, 0]


def test_a_batch_is_a_copy_that_later_samples_do_not_change() -> None:
    inbox = Inbox(4, drop=True)
    inbox.put(batch_of(0, 4))
    batch = inbox.get(0.0)
    inbox.put(batch_of(9, 4))
    assert batch.u.tolist() == [0, 1, 2, 3]


def test_a_failure_is_raised_once_what_came_before_it_has_been_taken() -> None:
    inbox = Inbox(4, drop=True)
    inbox.put(batch_of(0, 2))
    inbox.end(ZeroDivisionError("here"))
    assert len(inbox.get(PATIENCE)) == 2
    with pytest.raises(ZeroDivisionError, match="here"):
        inbox.get(PATIENCE)


class Unplugged(Wire):
    """A wire whose pauses are kept instead of waited for."""

    def __init__(self) -> None:
        super().__init__(Address("unplugged://", ""), None, UY)
        self.pauses: list[float] = []
        self._stop.wait = lambda pause: self.pauses.append(pause) or False  # type: ignore[method-assign,func-returns-value]

    def _session(self) -> None:
        """Nothing comes."""


def test_pauses_between_attempts_double_up_to_the_longest_and_begin_anew_with_a_connection() -> None:
    reader = Unplugged()
    for _ in range(8):
        reader._pause("refused")
        assert (reader.state, reader.trouble) == ("connecting", "refused")
    assert reader.pauses == pytest.approx([min(BACKOFF[0] * 2.0**k, BACKOFF[1]) for k in range(8)])
    reader._connected()
    assert (reader.state, reader.trouble, reader.counters) == ("connected", "", {})
    reader._pause("gone")
    assert (reader.state, reader.pauses[-1]) == ("waiting", BACKOFF[0])
    reader._connected()
    reader._connected()
    assert reader.counters == {"reconnects": 2}


def test_a_reader_holds_the_newest_where_the_sender_does_not_wait() -> None:
    reader = Unplugged()
    reader.seek(5)
    reader._deliver(batch_of(4, 4))  # 4 and 5 are known
    reader._deliver(None)
    reader._counts["not a number"] += 3
    assert reader._inbox.get(0.0).u.tolist() == [6.0, 7.0]
    assert reader.counters == {"duplicate": 2, "not a number": 3}
