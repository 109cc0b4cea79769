"""Sequence numbers: no sample is used twice, losses are counted, and resets are accepted if nothing is resent."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replant.live.streams.source import LEAP, MISORDER, Batch, Numbering
from support.cases import every, examples


def batch_of(numbers: list[int]) -> Batch:
    values = np.array(numbers, dtype=float)
    return Batch(values, -values, values / 10, np.array(numbers, dtype=np.int64), arrived=1.0)


def screen(numbering: Numbering, *batches: list[int]) -> list[int]:
    kept: list[int] = []
    for numbers in batches:
        batch = numbering.screen(batch_of(numbers))
        assert batch.sequence is not None
        assert batch.t is not None
        assert batch.u.tolist() == (-batch.y).tolist() == batch.sequence.tolist() == (batch.t * 10).tolist()
        kept += batch.sequence.tolist()
    return kept


@pytest.mark.parametrize("replays", [True, False])
def test_late_and_repeated_samples_are_dropped_and_gaps_counted(replays: bool) -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    assert screen(numbering, [5, 6, 7], [7, 8, 8, 11], [10, 9, 12], [12], [13]) == [5, 6, 7, 8, 11, 12, 13]
    assert counters == {"duplicate": 5, "lost": 2}
    assert numbering.last == 13


@pytest.mark.parametrize("replays", [True, False])
@settings(derandomize=True, max_examples=examples(200), deadline=None)
@given(batches=st.lists(st.lists(st.integers(0, 40), max_size=12), max_size=6), last=st.none() | st.integers(0, 40))
def test_samples_add_up_and_go_on(replays: bool, batches: list[list[int]], last: int | None) -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    numbering.last = last
    kept = screen(numbering, *batches)
    assert len(kept) + counters["duplicate"] == sum(map(len, batches))
    assert sorted(set(kept)) == kept
    if kept:
        start = kept[0] - 1 if last is None else last
        assert kept[0] > start
        assert counters["lost"] == kept[-1] - start - len(kept)


#: What the source is (whether it sends again), the last number, the batches, and what is kept and counted of them.
SCREENED: dict[str, tuple[bool, int | None, list[list[int]], list[int], dict[str, int]]] = {
    # the samples of a peer that starts from zero again are dropped until its numbers pass the last one
    "sent again": (True, 10_000, [[k, k + 1] for k in range(0, 10_004, 2)], [10_001, 10_002, 10_003],
                   {"duplicate": 10_001}),
    "a device that was reset is believed after two samples": (
        False, 10_000, [[0], [1], [2, 3], [5]], [1, 2, 3, 5], {"duplicate": 1, "restarts": 1, "lost": 1}),
    "a few late packets in order are no restart": (False, MISORDER, [[3, 4, 5, 6]], [], {"duplicate": 4}),
    # from 11 to 1011 it is 1000: 3011 confirms it, and is itself held back as the next leap; 3012 does not
    "a leap ahead, confirmed at twice its length": (
        True, None, [[10, 11], [1011], [3011]], [10, 11, 1011], {"number leap": 1, "lost": 999}),
    "a leap ahead, and a number beyond": (True, None, [[10, 11], [1011], [3012]], [10, 11], {"number leap": 2}),
    "fifty ahead is no leap": (True, None, [[10, 11], [11 + LEAP]], [10, 11, 11 + LEAP], {"lost": LEAP - 1}),
    "more than fifty ahead is": (True, None, [[10, 11], [12 + LEAP]], [10, 11], {"number leap": 1}),
    "a reset, confirmed within fifty": (False, 10_000, [[0], [LEAP]], [LEAP],
                                        {"duplicate": 1, "restarts": 1, "lost": LEAP - 1}),
    "a reset, not confirmed beyond": (False, 10_000, [[0], [LEAP + 1]], [], {"duplicate": 2}),
    "a thousand back is late": (False, 2 * MISORDER, [[MISORDER], [MISORDER + 1]], [], {"duplicate": 2}),
    "more than a thousand back is a reset": (
        False, 2 * MISORDER + 1, [[MISORDER], [MISORDER + 1]], [MISORDER + 1], {"duplicate": 1, "restarts": 1}),
    # if the last number comes from a checkpoint, the first connection has not delivered a number yet
    **{f"sent again to one that goes on from {last}: no counter that wrapped": (
        True, last, [[k, k + 1] for k in range(0, 40, 2)], [], {"duplicate": 40}) for last in (2**16 - 1, 2**32 - 1)},
}  # fmt: skip


@every(("replays", "last", "batches", "kept", "counted"), SCREENED.values(), ids=SCREENED)
def test_what_is_kept_and_counted(
    replays: bool, last: int | None, batches: list[list[int]], kept: list[int], counted: dict[str, int]
) -> None:
    numbering = Numbering(counters := Counter(), replays=replays)
    numbering.last = last
    assert screen(numbering, *batches) == kept
    assert +counters == counted


@every("replays", [True, False])
@every("parts", [1, 2, 8])
@every("misread", [900_000, 2**32, 2**53 - 1])
def test_a_misread_number_far_ahead_costs_its_sample_alone(replays: bool, parts: int, misread: int) -> None:
    numbers = [1, 2, misread, 4, 5, 6, 7, 8]
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    assert screen(numbering, *(part.tolist() for part in np.array_split(numbers, parts))) == [1, 2, 4, 5, 6, 7, 8]
    assert +counters == {"number leap": 1, "lost": 1}


@every("replays", [True, False])
@every("parts", [1, 3, 9])
def test_a_leap_that_its_successor_confirms_costs_no_sample(replays: bool, parts: int) -> None:
    """A cable was unplugged for hours, and the samples of that time are lost."""
    numbers = [1, 2, 3, 500_000, 500_001, 500_003, 900_000, 900_001, 900_002]
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    assert screen(numbering, *(part.tolist() for part in np.array_split(numbers, parts))) == numbers
    assert +counters == {"lost": 900_002 - len(numbers)}


@pytest.mark.parametrize("replays", [True, False])
def test_a_device_that_counts_in_steps_is_followed(replays: bool) -> None:
    """As one that counts milliseconds, and sends ten samples a second."""
    numbering = Numbering(Counter(), replays=replays)
    assert screen(numbering, *([number] for number in range(0, 10_000, 100))) == list(range(0, 9_900, 100))


@every("replays", [True, False])
@every("misread", [[2**32, 2**32], [2**40, 2**32], [2**32, 2**32 + 1, 2**32 + 2], [2**32, 2**33 - 20]])
def test_several_misread_numbers_in_a_row_cost_one_more_sample(replays: bool, misread: list[int]) -> None:
    """Even if they seem to confirm each other: none of the numbers between has been used."""
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    kept = screen(numbering, list(range(10)), misread, [number + 10 for number in range(20)])
    assert kept[-18:] == list(range(12, 30))
    assert counters["lost"] <= 2


@every("replays", [True, False])
@every("misread", [5_000, 2**32, 2**53 - 1])
def test_a_first_number_that_is_misread_does_not_end_the_stream(replays: bool, misread: int) -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    assert screen(numbering, [misread], [1], [2, 3], [4]) == [misread, 2, 3, 4]
    assert +counters == {"duplicate": 1, "restarts": 1}


@every("bits", [16, 32])
@every("replays", [True, False])
def test_a_counter_that_wraps_is_followed(replays: bool, bits: int) -> None:
    numbers = (np.arange(2**bits - 300, 2**bits + 200) % 2**bits).tolist()
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    assert screen(numbering, *([number] for number in numbers)) == [n for n in numbers if n != 0]
    assert +counters == {"duplicate": 1, "restarts": 1}


@pytest.mark.parametrize("last", [2**16 - 1, 70_000])
def test_what_a_new_connection_sends_again_is_no_counter_that_wrapped(last: int) -> None:
    """A peer that does not listen to ``after N`` sends all from its beginning."""
    numbering = Numbering(Counter(), replays=True)
    numbering.connect()
    assert screen(numbering, [last - 1, last]) == [last - 1, last]
    numbering.connect()
    assert screen(numbering, *(list(range(k, k + 16)) for k in range(0, last + 17, 16)))[0] == last + 1


def test_without_numbers_everything_is_kept() -> None:
    numbering = Numbering(Counter(), replays=True)
    batch = Batch(np.ones(2), np.ones(2), None, None, 0.0)
    assert numbering.screen(batch) is batch
    assert numbering.last is None
