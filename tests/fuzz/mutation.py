"""Mutants of checkpoints, the checksum repaired: what someone could make who knows the format.

The header is changed as the tree that it is (types, signs, extremes, entries missing, twice, swapped, too many), the
arrays by their slots and bits, and both together: a setting changed alike in all places where it stands, the arrays
fitted to it, so that more than the first comparison is tried.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import json
import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np

from replant.online.checkpoint.encoding import (
    DIGEST,
    MAGIC,
    START,
    VERSION,
)

Tree = Any
Path = tuple[Any, ...]

EXTREMES: list[Any] = [
    0, 1, -1, 2, 3, 5, 10, 11, 12, 255, 256, 1000, 4001, 2**15, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**62, 2**63 - 1,
    2**63, -(2**63), 2**64, 10**30, 10**400, 0.0, -0.0, 0.5, 1.0, 5.0, -1.0, 1e-320, 5e-324, 1e-9, 1e16, 1e100, 1e150,
    1e300, 1.7e308, True, False, None, "", "auto", "mean", "first", "square", "gbt", "foh", "x" * 300, [], {}, [0],
    [1.0] * 50, {"float": "nan"}, {"float": "inf"}, {"float": "-inf"}, {"tuple": []}, {"tuple": [1.0, 2.0]},
    {"tuple": [1.0] * 4001}, {"dict": []}, {"numpy": ["|u1", [], "05"]}, {"numpy": ["<i8", [], "05" + "00" * 7]},
    {"numpy": ["<f8", [], "000000000000f87f"]}, {"numpy": ["<f8", [0, 2**40], ""]}, {"numpy": ["|b1", [], "01"]},
    {"Replay": {"capacity": 10, "batch_size": 2, "warmup": 1, "seed": 0}},
    {"Replay": {"capacity": 2**31 - 1, "batch_size": 100_000, "warmup": 0, "seed": 2**63 - 1}},
    {"RefinedFilter": {"input_hold": "foh"}},
    {"Gradient": {"gain": 1e308}},
    {"RecursiveLeastSquares": {"forgetting_factor": 1e-300, "time_constant": None, "initial_covariance": 1e300}},
    {"KalmanTracking": {"process_noise": 0.0, "noise_time_constant": 1e-300, "initial_covariance": 1e-300}},
]  # fmt: skip
WHOLE = [
    -1,
    0,
    1,
    2,
    3,
    4,
    5,
    7,
    19,
    20,
    63,
    64,
    65,
    1000,
    9_999,
    10_000,
    10_001,
    2**31,
    2**40,
    2**62,
    2**63 - 1,
    -(2**63),
]
REAL = [
    math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 0.5, 1.0, 3.0, 4.0, 63.0, 64.0, 65.0, 5e-324, -5e-324, 1e-300, 1e-9,
    1e9, 1e16, 1e77, 1e150, 1e154, 1e155, 1e300, -1e300, 1.7e308,
]  # fmt: skip


def taken_apart(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Header and body of a checkpoint."""
    _, _, length = START.unpack_from(data)
    return json.loads(data[START.size : START.size + length]), data[START.size + length : -DIGEST]


def assembled(header: Any, body: bytes, *, twice: bool = False) -> bytes:
    """A checkpoint of these, its checksum right; with ``twice`` one entry of an object comes two times."""
    text = json.dumps(header)
    if twice and '": ' in text:
        start = text.index('"', len(text) // 3) if '"' in text[len(text) // 3 :] else 0
        colon = text.find('": ', start)
        name = text.rfind('"', 0, colon)
        if colon > 0 and name >= 0:
            text = text[:name] + text[name : colon + 3] + "0, " + text[name:]
    raw = text.encode()
    raw += b" " * (-len(raw) % 8)
    content = START.pack(MAGIC, VERSION, len(raw)) + raw + body
    return content + hashlib.sha256(content).digest()


def mutant(data: bytes, chance: random.Random) -> bytes:
    """A checkpoint with one change or a few."""
    header, body = taken_apart(data)
    header, twice = copy.deepcopy(header), False
    numbers = bytearray(body)
    for _ in range(chance.choice([1, 1, 1, 2, 3])):
        act = chance.choices(ACTS, WEIGHTS)[0]
        if act is _twice:
            twice = True
        else:
            with contextlib.suppress(LookupError, ValueError, TypeError, AttributeError, ArithmeticError):
                # a change before may have left nothing to change
                header, numbers = act(header, numbers, chance)
    return assembled(header, bytes(numbers), twice=twice)


Act = Callable[[Any, bytearray, random.Random], tuple[Any, bytearray]]


def _change_leaf(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    path, _ = chance.choice(_nodes(header, leaves=chance.random() < 0.8))
    return _with(header, path, _other(_at(header, path), chance)), body


def _change_alike(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    """Change a setting in what was asked for and in what it led to, then mostly fit the arrays to it."""
    try:
        asked = header["attributes"]["_request"]["Request"]
        settings = (header["attributes"]["_settings"] or {}).get("Settings")
        path, _ = chance.choice(_nodes(asked, leaves=chance.random() < 0.8))
        value = _other(_at(asked, path), chance)
        header["attributes"]["_request"]["Request"] = _with(asked, path, copy.deepcopy(value))
        if settings is not None:
            header["attributes"]["_settings"]["Settings"] = _with(settings, path, copy.deepcopy(value))
    except (KeyError, IndexError, TypeError, AttributeError):
        return header, body
    return _fitted(header, body) if chance.random() < 0.8 else (header, body)


def _fitted(header: Any, body: bytearray) -> tuple[Any, bytearray]:
    """Declare arrays as the settings need them, cut off or filled up by zeros; the whole numbers as they follow."""
    import warnings

    from replant.estimation.engine.state import State
    from replant.kernels.schema import StateSlots
    from replant.online.checkpoint.content_check import DECIDED, sizes_of
    from replant.online.checkpoint.settings_json import from_plain

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            settings, request = (from_plain(header["attributes"][name]) for name in ("_settings", "_request"))
            reference = header["attributes"]["_reference"]
            shapes = sizes_of(settings, request, reference=reference).shapes
            if math.prod(shapes["reals"]) + math.prod(shapes["recent"]) > 10**6:
                return header, body
            if settings is None:
                fresh = State.collecting(request, reference=reference)
            else:
                fresh = State.laid_out(settings, shapes["recent"][0])
    except Exception:  # there is nothing to fit to
        return header, body
    start, parts, declared = 0, [], []
    for name, kind, shape, rows in header["arrays"]:
        width = math.prod(shape[1:])
        old = np.frombuffer(bytes(body[start : start + 8 * rows * width]), kind).reshape(rows, *shape[1:])
        start += 8 * rows * width
        new_shape = shapes[name]
        new = np.zeros((min(rows, new_shape[0]), *new_shape[1:]), kind)
        some = tuple(slice(0, min(a, b)) for a, b in zip(old.shape, new.shape, strict=True))
        new[some] = old[some]
        if name == "ints":
            new = np.zeros(new_shape, kind)
            new[: min(rows, new_shape[0])] = old[: new_shape[0]]
            places = [slot.index for slot in StateSlots.integers if slot in DECIDED]
            places += [block.index for block in StateSlots.blocks]
            new[places] = fresh.ints[places]
        if name == "reals":
            new = fresh.reals.astype(kind)
        parts.append(new.tobytes())
        declared.append([name, kind, list(new_shape), len(new)])
    header["arrays"] = declared
    return header, bytearray(b"".join(parts))


def _drop(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    path, _ = chance.choice(_nodes(header, leaves=False))
    parent = _at(header, path)
    if isinstance(parent, dict) and parent:
        del parent[chance.choice(list(parent))]
    elif isinstance(parent, list) and parent:
        del parent[chance.randrange(len(parent))]
    return header, body


def _add(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    path, _ = chance.choice(_nodes(header, leaves=False))
    parent, value = _at(header, path), copy.deepcopy(chance.choice(EXTREMES))
    if isinstance(parent, dict):
        parent[chance.choice(["more", "_state", "__class__", "float", "Settings"])] = value
    elif isinstance(parent, list):
        parent.insert(chance.randint(0, len(parent)), value)
    return header, body


def _swap(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    nodes = _nodes(header, leaves=chance.random() < 0.7)
    (one, _), (other, _) = chance.choice(nodes), chance.choice(nodes)
    try:
        a, b = copy.deepcopy(_at(header, one)), copy.deepcopy(_at(header, other))
        return _with(_with(header, one, b), other, a), body
    except (KeyError, IndexError, TypeError):  # one lay within the other
        return header, body


def _twice(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    raise NotImplementedError  # by `assembled`


def _slots(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    """Change some slots of the whole numbers or of the others to extremes."""
    spans = _spans(header, body)
    if not spans:
        return header, body
    name, first, size = chance.choice(spans)
    for _ in range(chance.choice([1, 1, 1, 2, 5, 50])):
        place = 8 * (first + _place(name, size, chance))
        kind = "<i8" if name == "ints" else "<f8"
        old = np.frombuffer(bytes(body[place : place + 8]), kind)[0]
        new: Any = chance.choice(WHOLE if name == "ints" else REAL)
        if chance.random() < 0.3:
            with np.errstate(all="ignore"):
                new = chance.choice([old + 1, old - 1, -old, old * 2, old / 2])
        with np.errstate(all="ignore"):
            body[place : place + 8] = np.array([new]).astype(kind).tobytes()
    return header, body


def _bits(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    spans = _spans(header, body)
    if not spans:
        return header, body
    name, first, size = chance.choice(spans)
    for _ in range(chance.choice([1, 1, 2, 8])):
        body[8 * (first + _place(name, size, chance)) + chance.randrange(8)] ^= 1 << chance.randrange(8)
    return header, body


def _length(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    """Cut the arrays off, or make them longer, and mostly say so in the header."""
    by = 8 * chance.choice([-1000, -10, -1, 1, 2, 10, 1000])
    body = body[:by] if by < 0 else body + bytes(by)
    if chance.random() < 0.5:
        body = body[: chance.randrange(len(body) + 1)]
    try:
        declared = chance.choice(header["arrays"])
        which = chance.choice([2, 3])
        if which == 3:
            declared[3] += by // 8
        else:
            declared[2][chance.randrange(len(declared[2]))] += by // 8
    except (KeyError, IndexError, TypeError):
        pass
    return header, body


def _shift_rows(header: Any, body: bytearray, chance: random.Random) -> tuple[Any, bytearray]:
    """Exchange two pieces of the arrays."""
    rows = len(body) // 8
    if rows > 2:
        a, b = 8 * chance.randrange(rows), 8 * chance.randrange(rows)
        body[a : a + 8], body[b : b + 8] = body[b : b + 8], body[a : a + 8]
    return header, body


ACTS: list[Act] = [
    _change_leaf, _change_alike, _drop, _add, _swap, _twice, _slots, _bits, _length, _shift_rows,
]  # fmt: skip
WEIGHTS = [8, 8, 1, 1, 1, 0.3, 14, 4, 2, 1]


def _spans(header: Any, body: bytearray) -> list[tuple[str, int, int]]:
    """Where each array lies that has numbers: name, first number, how many."""
    spans, start = [], 0
    try:
        for name, _, shape, rows in header["arrays"]:
            size = rows * math.prod(shape[1:])
            if size > 0 and 8 * (start + size) <= len(body):
                spans.append((name, start, size))
            start += size
    except (KeyError, ValueError, TypeError, OverflowError):
        return []
    return spans


def _place(name: str, size: int, chance: random.Random) -> int:
    """A slot; of the reals the scalars at their beginning as often as all the blocks."""
    if name == "reals" and chance.random() < 0.4:
        return chance.randrange(min(size, 35))
    return chance.randrange(size)


def _nodes(tree: Tree, *, leaves: bool, path: Path = ()) -> list[tuple[Path, Tree]]:
    found = []
    if isinstance(tree, dict | list) and tree:
        if not leaves:
            found.append((path, tree))
        for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
            found += _nodes(value, leaves=leaves, path=(*path, key))
    elif leaves:
        found.append((path, tree))
    return found or [(path, tree)]


def _at(tree: Tree, path: Path) -> Tree:
    for key in path:
        tree = tree[key]
    return tree


def _with(tree: Tree, path: Path, value: Tree) -> Tree:
    if not path:
        return value
    tree = copy.copy(tree)
    tree[path[0]] = _with(tree[path[0]], path[1:], value)
    return tree


def _other(old: Any, chance: random.Random) -> Any:
    if type(old) in (int, float) and chance.random() < 0.6:
        near = [old + 1, old - 1, -old, old * 2, old / 2, float(old) if abs(old) < 1e300 else old, str(old), [old]]
        if abs(old) < 1e300:
            near += [int(old), {"numpy": ["|u1", [], f"{int(old) % 256:02x}"]}]
        new = chance.choice(near)
        return new if not isinstance(new, float) or math.isfinite(new) else 1e308
    return copy.deepcopy(chance.choice(EXTREMES))
