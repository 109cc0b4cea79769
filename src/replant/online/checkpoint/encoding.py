"""The bytes of a checkpoint: the complete state of an identifier, with every number of the schema, and no code.

    magic (8), version (uint32), length of the header (uint32),
    header: JSON in ASCII, padded by blanks to a multiple of 8: every value that is not an array, and for each array its
        name, type, shape and number of stored rows; with ``background`` also whether a job is pending,
    the arrays, one after the other, without work arrays and without final rows whose bits are all zero; after the
        arrays of the state those at the begin of a pending job,
    SHA-256 of all bytes above (32).

All numbers are little-endian.  The checksum detects damage, not forgery: it is not a signature.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import struct
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, DamagedCheckpointError, InvalidArgumentError, shown
from replant.estimation.engine.state import State
from replant.estimation.settings import Request, Settings
from replant.kernels.schema import STATE_ARRAYS, StateSlots
from replant.online.background import NUMBERS, Job, state_of
from replant.online.checkpoint.content_check import (
    check_collected,
    check_job,
    check_settings,
    check_start,
    check_state,
    layout_of_state,
    sizes_of,
)
from replant.online.checkpoint.earlier_versions import BEFORE, from_before, with_work, without_work, work_of
from replant.online.checkpoint.settings_json import from_plain, to_plain
from replant.online.checkpoint_file import Progress

MAGIC = b"\x89replant"

VERSION = 7  # increased when the meaning of an entry changes; the layout is checked separately [number]

START = struct.Struct("<8sII")
DIGEST = 32  # length of the checksum, of SHA-256 [bytes]
LONGEST_HEADER = 2**20  # longest header that is read [bytes]
LARGEST = 2**34  # largest total of arrays, including rows not stored: no state needs 16 GiB [bytes]

#: The attributes of an identifier that are not arrays, and their types.
ATTRIBUTES: dict[str, type | tuple[type, ...]] = {
    "_request": Request,
    "_settings": (Settings, type(None)),
    "_reference": bool,
    "_regular": bool,
    "_hold": int,
    "_dropped": int,
    "_resolve_at": int,
}
STATE = "_state"  # the attribute that is stored as arrays

#: The header's entry that replaces the attributes, for an identifier of several inputs, and of several structures.
OTHERS = ROW, BANK = "row", "bank"
#: The header's entries.
HEADER = LAYOUT, ATTRIBUTE, PROGRESS, ARRAYS = "layout", "attributes", "progress", "arrays"
BACKGROUND = "background"  # whether a job is pending; only for an identifier that solves in the background
OF_JOB = "job_"  # prefix of the names of its arrays
INT, FLOAT = "<i8", "<f8"  # types of arrays


@dataclass(frozen=True, eq=False)
class Contents:
    """The content of a checkpoint."""

    attributes: dict[str, Any]  # attributes of the identifier, without those determined by others
    progress: dict[str, int | float | str]  # entries of the caller, such as the number of samples read and counters


def encode(attributes: Mapping[str, Any], progress: Progress | None = None) -> bytes:
    """Return the bytes of an identifier with these attributes; equal identifiers give equal bytes."""
    written, job = _written(attributes[STATE], STATE_ARRAYS), attributes.get("_job")
    if job is not None:
        written |= {OF_JOB + name: each for name, each in _written(job.numbers, NUMBERS).items()}
    return _sealed(
        ({BACKGROUND: job is not None} if attributes.get("_background") else {})
        | {
            LAYOUT: layout_of_state(),
            ATTRIBUTE: {name: to_plain("", attributes[name]) for name in ATTRIBUTES},
            PROGRESS: _plain(progress),
            ARRAYS: [[name, _type(name), list(array.shape), rows] for name, (array, rows) in written.items()],
        },
        {name: np.asarray(array[:rows], _type(name)) for name, (array, rows) in written.items()},
    )


def _written(state: State, names: Sequence[str]) -> dict[str, tuple[Any, int]]:
    """Return the arrays of a state in the order of storage, each with the number of its rows in use."""
    arrays = {name: getattr(state, name) for name in names}
    arrays["reals"] = without_work(state.reals, *work_of(state.ints))
    filled = {"buffer": state.buffer_filled}  # searching a large buffer for its used rows would be slow
    return {name: (array, _rows_in_use(array[: filled.get(name)])) for name, array in arrays.items()}


def encode_other(
    kind: str, plain: dict[str, Any], arrays: Mapping[str, np.ndarray[Any, Any]], progress: Progress | None
) -> bytes:
    """Return the bytes of an identifier of another kind: values as JSON, and arrays with any names."""
    written = {name: np.asarray(array, INT if array.dtype.kind == "i" else FLOAT) for name, array in arrays.items()}
    shapes = [[name, array.dtype.str, list(array.shape)] for name, array in written.items()]
    return _sealed({kind: plain, PROGRESS: _plain(progress), ARRAYS: shapes, LAYOUT: layout_of_state()}, written)


def _sealed(content: dict[str, Any], arrays: Mapping[str, np.ndarray[Any, Any]]) -> bytes:
    """Return header, arrays and digest."""
    header = json.dumps(content, allow_nan=False, separators=(",", ":")).encode("ascii")
    header += b" " * (-len(header) % 8)
    if len(header) > LONGEST_HEADER or sum(array.nbytes for array in arrays.values()) > LARGEST:
        raise InvalidArgumentError("this is too large for a checkpoint: use a smaller buffer, or less progress")
    parts = [START.pack(MAGIC, VERSION, len(header)), header, *(array.tobytes() for array in arrays.values())]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return b"".join([*parts, digest.digest()])


def decode(data: bytes | bytearray | memoryview) -> Contents:
    """Return the arguments of `encode`."""
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ArgumentTypeError(f"data must be bytes, got {type(data).__name__}")
    header, body = _parts(bytes(data))
    with described():
        return _contents(header, body)


@contextlib.contextmanager
def described() -> Iterator[None]:
    """Turn any exception into DamagedCheckpointError: a forged header fails with almost any of them."""
    try:
        yield
    except (DamagedCheckpointError, MemoryError):  # lack of memory does not mean that the checkpoint is damaged
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DamagedCheckpointError(f"it does not describe an identifier of this version ({reason[:120]})") from error


def _type(name: str) -> str:
    return INT if name.removeprefix(OF_JOB) == "ints" else FLOAT


def _plain(progress: Progress | None) -> dict[str, Any]:
    return {name: to_plain(f"progress[{name!r}]", value) for name, value in _checked(progress).items()}


def _checked(progress: Progress | None) -> dict[str, int | float | str]:
    if not isinstance(progress, Mapping | None):
        raise ArgumentTypeError(f"progress must be a dict, got {type(progress).__name__} {shown(progress)}")
    for name, value in (progress or {}).items():
        if type(name) is not str or type(value) not in (int, float, str):
            raise InvalidArgumentError(
                f"progress must map names to int, float or str, got {shown(name)}: {shown(value)}"
            )
    return dict(progress or {})


def _rows_in_use(array: np.ndarray[Any, Any]) -> int:
    """Return the number of rows up to the last one with a bit set; a large buffer is often mostly empty."""
    bits = array.view(np.uint64)
    # bisection: "all rows from this one on are zero" is monotone in the row
    return bisect_left(range(len(bits)), True, key=lambda row: not bits[row:].any())


def _parts(data: bytes) -> tuple[dict[str, Any], memoryview]:
    """Return header and arrays, after a check that the bytes are complete and undamaged."""
    if not data:
        raise DamagedCheckpointError("it is empty")
    if data[: len(MAGIC)] != MAGIC:
        others = "`load_model` reads a model, and `read_log` a log"
        raise DamagedCheckpointError(f"it is not a checkpoint; `Identifier.save` writes one, {others}")
    if len(data) < START.size + DIGEST:
        raise DamagedCheckpointError("it is cut off")
    _, version, length = START.unpack_from(data)
    if version not in (BEFORE, VERSION):
        known = f"this replant reads versions {BEFORE} and {VERSION}: use the replant that wrote it, or begin anew"
        raise DamagedCheckpointError(f"its format is version {version}; {known}")
    view = memoryview(data)
    if hashlib.sha256(view[:-DIGEST]).digest() != data[-DIGEST:]:
        raise DamagedCheckpointError("it is damaged or cut off: its checksum does not match")
    body = START.size + length
    if length > LONGEST_HEADER or body > len(data) - DIGEST:
        raise DamagedCheckpointError("its header is longer than the file")
    try:
        text = view[START.size : body].tobytes().decode("ascii")
        header = json.loads(text, object_pairs_hook=_once, parse_float=_finite, parse_constant=_finite)
    except (ValueError, RecursionError) as error:
        raise DamagedCheckpointError("its header is not JSON") from error
    if not isinstance(header, dict):
        raise DamagedCheckpointError("its header is not an object")
    arrays = view[body:-DIGEST]
    if version == VERSION:
        return header, arrays
    try:
        return from_before(header, arrays)
    except Exception as error:  # a forged header fails with almost any exception
        raise DamagedCheckpointError(f"it is not as version {BEFORE} writes one") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) != len(pairs):
        raise ValueError("an entry occurs twice")
    return dict(pairs)


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text} is not a number in JSON")
    return value


def _contents(header: dict[str, Any], body: memoryview) -> Contents:
    """Return the content that header and arrays describe; settings are checked first, then sizes, then numbers."""
    other = next((entry for entry in OTHERS if entry in header), None)
    entries, more = (set(HEADER), {BACKGROUND}) if other is None else ({other, LAYOUT, PROGRESS, ARRAYS}, set())
    if set(header) - more != entries or type(header.get(BACKGROUND, False)) is not bool:
        raise DamagedCheckpointError("its header has other entries")
    if header[LAYOUT] != layout_of_state():
        raise DamagedCheckpointError("it is of another version of replant, with another layout of the state")
    progress = _checked({name: from_plain(plain) for name, plain in header[PROGRESS].items()})
    if other is None:
        return Contents(_attributes(header, body), progress)
    declared = [[str(name), kind, shape, shape[0]] for name, kind, shape in header[ARRAYS]]  # every row is stored
    return Contents({other: header[other], ARRAYS: _arrays(declared, body)}, progress)


def _attributes(header: dict[str, Any], body: memoryview) -> dict[str, Any]:
    """Return the attributes of an identifier, checked."""
    attributes = {name: from_plain(plain) for name, plain in header[ATTRIBUTE].items()}
    for name, value in attributes.items():
        if isinstance(value, np.generic):  # earlier versions stored NumPy numbers as the caller had passed them
            attributes[name] = value.item()
    if list(attributes) != list(ATTRIBUTES):
        raise DamagedCheckpointError("it is of another version of replant: it has other attributes")
    for name, kind in ATTRIBUTES.items():
        if type(attributes[name]) not in (kind if isinstance(kind, tuple) else (kind,)):
            raise TypeError(f"{name.lstrip('_')} is a {type(attributes[name]).__name__}")
    check_start(attributes["_request"], attributes["_hold"], reference=attributes["_reference"])
    state, job = _state(attributes, header[ARRAYS], body, has_job=header.get(BACKGROUND, False))
    in_background = {"_background": True, "_job": job} if BACKGROUND in header else {}
    return attributes | {STATE: state, "_mapped": False} | in_background  # a callable input map is not stored


def _state(
    attributes: dict[str, Any], declared: list[Any], body: memoryview, *, has_job: bool
) -> tuple[State, Job | None]:
    """Return the arrays of an identifier and the pending job, checked."""
    settings: Settings | None = attributes["_settings"]
    request, reference, resolve_at = attributes["_request"], attributes["_reference"], attributes["_resolve_at"]
    if settings is not None:
        check_settings(settings, request, reference=reference)
    elif has_job:
        raise DamagedCheckpointError("it has a pending job, but no record yet")
    # rows in use of buffer and raw samples, as no used row is all zero
    *_, (_, _, _, rows), (_, _, (room, *_), samples) = declared[: len(STATE_ARRAYS)]
    sizes = sizes_of(settings, request, room if type(room) is int else 0, reference=reference)
    shapes = {name: sizes.shapes[name] for name in STATE_ARRAYS}
    of_job = {OF_JOB + name: sizes.shapes[name] for name in NUMBERS} if has_job else {}
    arrays, begins = _arrays(declared, body, shapes | of_job), sizes.begins
    for name in {"reals", f"{OF_JOB}reals"} & set(arrays):
        arrays[name] = with_work(arrays[name], begins[StateSlots.backup], begins[StateSlots.past])
    state = State(**{name: arrays[name] for name in shapes})
    if not 0 <= state.buffer_filled <= rows:
        raise DamagedCheckpointError("its buffer holds fewer samples than its state says")
    if settings is None:
        if not 0 <= min(state.samples, len(state.recent)) <= samples:
            raise DamagedCheckpointError("it has collected fewer samples than its state says")
        check_collected(state, request, resolve_at, reference=reference)
        return state, None
    job = None
    if has_job:
        begun = state_of([arrays[name] for name in of_job], state.recent)
        check_state(begun, settings, resolve_at, request.history, has_job=True)
        job = Job.of(begun)
    check_state(state, settings, resolve_at, request.history, has_job=has_job)
    if job is not None:
        check_job(job, state)
    return state, job


def _arrays(declared: list[Any], body: memoryview, shapes: dict[str, tuple[int, ...]] | None = None) -> dict[str, Any]:
    """Return arrays of these shapes, by default any; all declarations are checked before an array is allocated."""
    if shapes is not None and [name for name, *_ in declared] != list(shapes):
        raise ValueError("other arrays")
    if shapes is not None and sum(8 * math.prod(shape) for shape in shapes.values()) > LARGEST:
        raise DamagedCheckpointError("its settings need arrays that are too large")
    for name, kind, shape, rows in declared:
        kinds = (INT, FLOAT) if shapes is None else (_type(name),)
        if kind not in kinds or not shape or any(type(size) is not int or size < 0 for size in [*shape, rows]):
            raise ValueError(f"{name} is declared as {kind!r:.40} {shape!r:.60}")
        if shapes is not None and tuple(shape) != shapes[name]:
            raise DamagedCheckpointError(
                f"its {name} have the shape {str(shape)[:60]}, and its settings need {list(shapes[name])}"
            )
        if rows > shape[0]:
            raise ValueError(f"{name} is declared too large")
    stored = sum(8 * rows * math.prod(shape[1:]) for _, _, shape, rows in declared)
    if stored != len(body):
        raise DamagedCheckpointError(f"its arrays are declared as {stored} bytes, but it holds {len(body)}")
    arrays, start = {}, 0
    for name, kind, shape, rows in declared:
        array = arrays[name] = np.zeros(shape, np.dtype(kind).newbyteorder("="))
        used = array[:rows]
        used[:] = np.frombuffer(body, kind, used.size, start).reshape(used.shape)
        start += used.nbytes
    return arrays
