"""The bytes of a checkpoint: one wrong bit, a byte too few, sizes that lie: refused with a reason, never guessed at."""

from __future__ import annotations

import hashlib
import json
import re
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import replant as rp
from replant.kernels import schema as at
from replant.kernels.schema import BRIDGED, DOUBTED, INPUT, OUTPUT, STEP
from replant.online.checkpoint.earlier_versions import BEFORE
from replant.online.checkpoint.encoding import (
    DIGEST,
    MAGIC,
    START,
    VERSION,
    decode,
)
from support.builders import engine_state, identifier, random_plant, record
from support.cases import every


def running(samples: int = 3) -> rp.Identifier:
    """One whose checkpoint is small: it began at once, and little has come."""
    ident = identifier(structure=rp.Structure(1))
    for k in range(samples):
        ident.update(float(k % 2), 0.1 * k)
    return ident


def starting() -> rp.Identifier:
    ident = rp.Identifier(rp.Structure(1), 0.1)
    for k in range(4):
        ident.update(float(k % 2), 0.1 * k)
    return ident


SMALL = {"running": running().to_bytes({"sequence": 3}), "starting": starting().to_bytes()}
every_checkpoint = pytest.mark.parametrize("data", SMALL.values(), ids=SMALL)


def sealed(content: bytes) -> bytes:
    """Bytes with a checksum that is right: what someone could make who means it."""
    return content + hashlib.sha256(content).digest()


def parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    _, _, length = START.unpack_from(data)
    return json.loads(data[START.size : START.size + length]), data[START.size + length : -DIGEST]


def assembled(header: Any, body: bytes) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return sealed(START.pack(MAGIC, VERSION, len(text)) + text + body)


def reason(data: bytes) -> str:
    """Why these bytes are refused: one line."""
    with pytest.raises(rp.DamagedCheckpointError) as caught:
        rp.Identifier.from_bytes(data)
    words = str(caught.value)
    assert words
    assert "\n" not in words
    return words


@every_checkpoint
def test_every_single_flipped_bit_is_refused(data: bytes) -> None:
    assert rp.Identifier.from_bytes(data).to_bytes(decode(data).progress) == data
    for place in range(len(data)):
        for bit in range(8):
            flipped = bytearray(data)
            flipped[place] ^= 1 << bit
            with pytest.raises(rp.DamagedCheckpointError):
                decode(flipped)


@every_checkpoint
def test_every_cut_and_anything_appended_is_refused(data: bytes) -> None:
    for length in range(len(data)):
        with pytest.raises(rp.DamagedCheckpointError):
            decode(data[:length])
    for tail in (b"\0", b"\n", data):
        with pytest.raises(rp.DamagedCheckpointError):
            decode(data + tail)


def test_the_reasons() -> None:
    data = SMALL["running"]
    assert reason(b"") == "it is empty"
    assert "read_log" in reason(b"t,u,y\n0.0,1.0,0.0\n")
    assert reason(data[:20]) == "it is cut off"
    assert "checksum" in reason(data[:-1])
    assert "checksum" in reason(data[:200] + bytes(100) + data[300:])


def test_another_version_is_refused_and_the_one_that_can_be_read_is_named() -> None:
    data = SMALL["running"]
    newer = sealed(START.pack(MAGIC, VERSION + 1, 8) + data[START.size : -DIGEST])
    said = reason(newer)
    assert said.startswith(f"its format is version {VERSION + 1}; this replant reads versions {BEFORE} and {VERSION}: ")


@given(st.binary(max_size=200))
def test_any_bytes_are_refused(noise: bytes) -> None:
    for data in (noise, MAGIC + noise, sealed(MAGIC + noise), sealed(START.pack(MAGIC, VERSION, len(noise)) + noise)):
        assert reason(data)


@every("data", ["text", None, 3, [1, 2]])
def test_what_is_no_bytes_is_a_type_error(data: Any) -> None:
    with pytest.raises(rp.ArgumentTypeError, match="data must be bytes"):
        rp.Identifier.from_bytes(data)


def test_any_kind_of_bytes_will_do() -> None:
    data = SMALL["running"]
    for kind in (bytes, bytearray, memoryview):
        assert rp.Identifier.from_bytes(kind(data)).samples == 3


# --- a right checksum over wrong content


@every_checkpoint
def test_a_forged_header_gives_an_identifier_or_a_reason(data: bytes) -> None:
    """Flip any bit of it and seal it again: never another kind of error, whatever it then says."""
    _, _, length = START.unpack_from(data)
    refused = 0
    for place in range(8, START.size + length):
        for bit in range(0, 8, 3):
            forged = bytearray(data[:-DIGEST])
            forged[place] ^= 1 << bit
            try:
                decode(sealed(bytes(forged)))
            except rp.DamagedCheckpointError:
                refused += 1
    assert refused > length


KERNELS: dict[str, dict[str, Any]] = {
    "plain": {},
    "gradient": {"optimizer": rp.Adam(1e-3), "instruments": True, "structure": rp.Structure(2, 1, delay=0.12)},
    "second order": {"optimizer": rp.KalmanTracking(1e-3), "filter": rp.RefinedFilter(), "instruments": "auto"},
    "solved again": {"optimizer": "auto", "filter": "auto", "instruments": "auto"},
}


@every("kind", KERNELS, quick=1)
def test_forged_positions_do_not_reach_the_kernels(kind: str) -> None:
    """Flip bits of each whole number of the state: it is refused, or runs on inside of its arrays."""
    ident = identifier(dt=0.2, startup=100, **KERNELS[kind])
    u, y = record(random_plant(2, 2, 1), 1, 240, 0.2)
    ident.update_many(u[:215], y[:215])  # the record is solved again at 225
    assert ident.status == "running"
    header, body = parts(ident.to_bytes())
    (name, _, (size,), rows), *_ = header["arrays"]
    assert (name, size) == ("ints", len(engine_state(ident).ints))
    refused = 0
    for slot in range(rows):
        for bit in (0, 1, 4, 20, 40, 62, 63):
            forged = bytearray(body)
            forged[8 * slot + bit // 8] ^= 1 << bit % 8
            try:
                other = rp.Identifier.from_bytes(assembled(header, bytes(forged)))
            except rp.DamagedCheckpointError:
                refused += 1
            else:
                other.update_many(u[215:], y[215:])
    assert refused > 7 * 30  # sizes and offsets: none of their bits


def change(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    *way, last = path.split("/")

    def act(header: dict[str, Any]) -> None:
        for key in way:
            header = header[int(key) if isinstance(header, list) else key]  # type: ignore[assignment]
        header[int(last) if isinstance(header, list) else last] = value  # type: ignore[index]

    return act


BUFFER = 3  # its place in the header's list of arrays


@every(
    ("act", "words"),
    [
        (change(f"arrays/{BUFFER}/2", [2**40, 6]), "buffer have the shape"),
        (change(f"arrays/{BUFFER}/2", [2**31, 2**31]), "buffer have the shape"),
        (change(f"arrays/{BUFFER}/2", [0, 2**62, 2**62]), "differ|declared|settings"),
        (change(f"arrays/{BUFFER}/2", [-1, 6]), "declared as"),
        (change(f"arrays/{BUFFER}/2", [50.0, 6]), "declared as"),
        (change(f"arrays/{BUFFER}/2", []), "declared as"),
        (change(f"arrays/{BUFFER}/1", "|O"), "declared as"),
        (change(f"arrays/{BUFFER}/3", 51), "declared too large"),
        (change(f"arrays/{BUFFER}/3", 2), "its arrays are declared as"),
        (change(f"arrays/{BUFFER}/2", [49, 4]), "buffer have the shape"),
        (change("arrays/1/2", [10_000]), "its reals have the shape"),
        (change("arrays/0/0", "reals"), "other arrays"),
        (change("attributes/_settings/Settings/replay/Replay/capacity", 2**30), "differ in replay"),
        (change("attributes/_settings/Settings/optimizer", {"Gradient": {"gain": 1.0}}), "settings"),
        (change("attributes/_settings/Settings/structure/Structure/poles", 2), "must have 3 entries"),
        (change("attributes/_settings/Settings/structure/Structure/poles", 0), "poles must be at least 1"),
        (change("attributes/_settings/Settings/dt", "soon"), "identifier"),
        (change("attributes/_hold", "long"), "hold is a str"),
        (change("attributes/_request", None), "request is a NoneType"),
        (change("attributes/_news", 1), "has other attributes"),
        (change("attributes", {}), "has other attributes"),
        (change("layout", "0123456789abcdef"), "with another layout of the state"),
        (change("layout", None), "with another layout of the state"),
        (change("progress/where", [1]), "progress must map"),
        (change("progress", []), "identifier"),
    ],
)
def test_a_forged_entry_is_refused(act: Callable[[dict[str, Any]], None], words: str) -> None:
    header, body = parts(SMALL["running"])
    assert header["arrays"][BUFFER][0] == "buffer"
    act(header)
    tracemalloc.start()
    try:
        with pytest.raises(rp.DamagedCheckpointError, match=words):
            decode(assembled(header, body))
        assert tracemalloc.get_traced_memory()[1] < 2**22, "something large was allocated before it was checked"
    finally:
        tracemalloc.stop()


def entry_twice() -> bytes:
    data = SMALL["running"]
    _, _, length = START.unpack_from(data)
    return assembled(data[START.size : START.size + length].rstrip()[:-1] + b',"progress":{}}', parts(data)[1])


@every(
    ("data", "words"),
    [
        *(
            (assembled(header, b""), "")
            for header in (
                b"[]", b"3", b"{}", b"", b"\xff", b"[" * 100_000, b'{"arrays":' * 50_000, b'{"attributes":{"a":NaN}}'
            )
        ),
        (entry_twice(), "JSON"),
        (sealed(START.pack(MAGIC, VERSION, 2**32 - 1) + b"{}"), "longer"),
        (sealed(START.pack(MAGIC, VERSION, 3) + b"{}"), "longer"),
    ],
    ids=lambda part: repr(part[START.size :])[:30],
)  # fmt: skip
def test_a_header_that_is_none_or_longer_than_the_file_is_refused(data: bytes, words: str) -> None:
    assert words in reason(data)


def peak_of_refusal(data: bytes, words: str) -> int:
    """Bytes that were allocated at the most before these were refused."""
    tracemalloc.start()
    try:
        with pytest.raises(rp.DamagedCheckpointError, match=words):
            decode(data)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@every("samples", [3, 30_000_000, 2**60, 4.0, True, -1, "4", None])
def test_samples_that_are_not_in_the_file_are_not_collected(samples: Any) -> None:
    """Two thousand bytes that say so take no gigabytes."""
    header, body = parts(SMALL["starting"])
    for startup in (500, 2**31 - 1):
        header["attributes"]["_request"]["Request"]["startup"] = header["attributes"]["_hold"] = startup
        for rows in (0, 4, samples):
            header["arrays"][-1] = ["recent", "<f8", [samples, 5], rows]
            assert peak_of_refusal(assembled(header, body), ".") < 2**20


def test_more_samples_than_are_in_the_file_are_not_collected() -> None:
    header, body = parts(SMALL["starting"])
    ints = np.frombuffer(body[: 8 * header["arrays"][0][3]], "<i8").copy()
    ints[at.StateSlots.samples.index] = ints[at.StateSlots.recent_head.index] = 5
    assert "fewer samples" in reason(assembled(header, ints.tobytes() + body[ints.nbytes :]))


@every("due", [-1, 0, 4, 30_001, 2**62])
def test_a_start_up_that_waits_for_a_sample_that_cannot_come_is_refused(due: int) -> None:
    ident = starting()
    ident._state.attention_at = due
    assert re.search("does not wait|points outside", reason(ident.to_bytes()))


@pytest.mark.parametrize("order", [11, 4_000, 40_000])
def test_the_order_of_a_filter_is_bounded_before_its_roots_are_looked_for(order: int) -> None:
    header, body = parts(SMALL["starting"])
    header["attributes"]["_request"]["Request"]["filter"] = {
        "StateVariableFilter": {
            "cutoff": None, "denominator": [1.0] * (order + 1), "method": "exact", "input_hold": "zoh", "alpha": 0.5,
        }
    }  # fmt: skip
    assert peak_of_refusal(assembled(header, body), "order 10 at most") < 2**23


@every("where", ["_request/Request", "_settings/Settings"])
@every(
    ("path", "value"),
    [
        ("structure/Structure/poles", 1.0),
        ("structure/Structure/poles", True),
        ("structure/Structure/poles", {"numpy": ["|u1", [], "05"]}),
        ("structure/Structure/zeros", 2**70),
        ("structure/Structure/delay", 1e300),
        ("structure/Structure/delay", True),
        ("replay/Replay/batch_size", 10**9),
        ("replay/Replay/capacity", 50.0),
        ("replay/Replay/seed", -1),
        ("dt", 0.0),
        ("dt", 1e-320),
        ("normalize", 1),
        ("startup", 10**400),
        ("startup", -1),
    ],
    ids=lambda part: str(part)[:30],
)
def test_a_setting_that_cannot_be_or_stands_alone_is_refused(where: str, path: str, value: Any) -> None:
    header, body = parts(SMALL["running"])
    change(f"attributes/{where}/{path}", value)(header)
    assert peak_of_refusal(assembled(header, body), ".") < 2**20


@every("name", ["_hold", "_resolve_at"])
@every("value", [-1, 0.0, True, 2**64, 10**400, None, [0]], ids=lambda value: str(value)[:30])
def test_a_count_that_cannot_be_is_refused(name: str, value: Any) -> None:
    for data in SMALL.values():
        header, body = parts(data)
        header["attributes"][name] = value
        assert reason(assembled(header, body))


@every(
    ("column", "value"),
    [(INPUT, np.nan), (OUTPUT, np.inf), (OUTPUT, 1e200), (STEP, 0.0), (STEP, np.inf), (BRIDGED, np.nan), (DOUBTED, 7)],
)
def test_samples_that_no_identifier_accepts_are_not_collected(column: int, value: float) -> None:
    ident = starting()
    ident._state.recent[2, column] = value
    assert "not accepted" in reason(ident.to_bytes())


def test_a_buffer_that_says_it_is_full_and_is_not_in_the_file_is_refused() -> None:
    """What is all zero need not be stored, but for samples that were written it is not looked through in vain."""
    header, body = parts(SMALL["running"])
    capacity = 2**27
    for name, kind in (("_request", "Request"), ("_settings", "Settings")):
        header["attributes"][name][kind]["replay"]["Replay"]["capacity"] = capacity
    header["arrays"][BUFFER][2][0] = capacity
    ints = np.frombuffer(body[: 8 * header["arrays"][0][3]], "<i8").copy()
    ints[at.StateSlots.capacity.index], ints[at.StateSlots.warmup.index] = capacity, min(4, capacity - 1)
    assert decode(assembled(header, ints.tobytes() + body[ints.nbytes :])).attributes
    ints[at.StateSlots.buffer_filled.index] = capacity
    assert "fewer samples" in reason(assembled(header, ints.tobytes() + body[ints.nbytes :]))


# --- what goes along, and what it costs


def test_progress_goes_along_exactly() -> None:
    progress = {"sequence": 2**60, "seconds": 0.1 + 0.2, "never": float("inf"), "source": 'tcp://[::1]:9 "\u00e9\ud800'}
    assert decode(running().to_bytes(progress)).progress == progress
    assert decode(running().to_bytes()).progress == {}


KINDS = "progress must map names to int, float or str"


@every(
    ("progress", "message"),
    [
        *((each, KINDS) for each in ({"a": None}, {"a": True}, {"a": np.int64(3)}, {"a": [1]}, {3: 1})),
        ({"story": "x" * 2**20}, "too large"),
    ],
    ids=lambda part: str(part)[:30],
)
def test_progress_of_other_kinds_or_too_much_is_refused(progress: Any, message: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=message):
        running().to_bytes(progress)


def test_rows_that_were_never_written_cost_nothing() -> None:
    """A buffer of 240000 rows holds no more than came in; it comes back whole."""
    wide = identifier(replay=rp.Replay(capacity=240_000, batch_size=4, warmup=4))
    sizes = []
    for _ in range(3):
        wide.update_many(np.ones(100), np.ones(100))
        sizes.append(len(wide.to_bytes()))
    assert sizes[0] < 30_000
    row = 8 * (engine_state(wide).buffer.shape[1] + 3)  # the buffer's and that of the raw samples
    assert abs(sizes[2] - sizes[1] - 100 * row) <= 16
    assert engine_state(rp.Identifier.from_bytes(wide.to_bytes())).buffer.shape == engine_state(wide).buffer.shape


def test_a_negative_zero_is_no_row_that_was_never_written() -> None:
    ident = rp.Identifier(rp.Structure(1), 0.1)
    ident.update(-0.0, -0.0, -0.0)
    (row,) = rp.Identifier.from_bytes(ident.to_bytes()).recent
    assert np.signbit(row[:2]).all()


def test_the_size_stays_once_the_rings_are_full() -> None:
    ident = running()
    ident.update_many(np.ones(31_000), np.ones(31_000))
    size = len(ident.to_bytes())
    ident.update_many(np.ones(50_000), np.ones(50_000))
    assert abs(len(ident.to_bytes()) - size) <= 8
    assert ident.samples == 81_003
