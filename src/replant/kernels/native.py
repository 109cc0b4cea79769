"""Kernels as Python calls them: compiled to a native library by the build, or interpreted.

`kernel` marks what Python calls, with the types of its arguments as annotations, and what must hold of their lengths.
The library checks both before a kernel runs: what does not fit is an error, never a crash.

In a clone the library is made by the build, and made again here, in seconds, where the kernels have changed since.
"""

import ctypes
import functools
import hashlib
import platform
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from replant.errors import UnsupportedDependencyError
from replant.kernels.schema import Attention, StateArrays
from replant.kernels.slot_tables import Fields

Ints = np.ndarray[Any, np.dtype[np.int64]]
IntMatrix = np.ndarray[Any, np.dtype[np.int64]]
Reals = np.ndarray[Any, np.dtype[np.float64]]
Matrix = np.ndarray[Any, np.dtype[np.float64]]
Cube = np.ndarray[Any, np.dtype[np.float64]]

FOLDER = Path(__file__).parent
LIBRARY = (
    FOLDER / "compiled" / {"win32": "libreplant.dll", "darwin": "libreplant.dylib"}.get(sys.platform, "libreplant.so")
)
KERNELS: list["Kernel"] = []  # in the order in which they were defined
# addresses and shapes of five arrays, the gate, which step; its size
INTS, REALS, BANKS, BUFFER, RECENT, GATE, KIND, SIZE = 0, 2, 4, 7, 10, 13, 14, 15  # places in a step's table [index]
OPEN, SHUT = 0, 1  # values of the gate: samples are taken, or refused because another call is under way [number]

# What must hold of a state's arrays, see `replant.kernels.step.soundness`.
LAID_OUT: Final = "is_laid_out(s, s.reals.size, s.banks.shape[0], s.banks.shape[1])"
IS_SOUND: Final = "is_sound(s)"
#: Of kernels that go on from an estimate: what a state that still collects has not filled in is looked at as well.
LEARNS: Final = "not s.collects"
#: Of kernels that take many samples.
AS_MANY: Final = (
    "y.size == u.size and errors.size >= u.size",
    "(t.size == 0 or t.size == u.size) and (r.size == 0 or r.size == u.size)",
    "parameters.shape[0] >= u.size and 0 <= parameters.shape[1] <= s.entries",
)

_interpreted = False
_loading = threading.Lock()


class Kernel:
    """A kernel that Python calls; `python` is the function as it is written."""

    def __init__(self, function: Callable[..., Any], requirements: tuple[str, ...]) -> None:
        functools.update_wrapper(self, function)
        self.python, self.requirements = function, requirements
        self.name = f"{function.__module__.removeprefix('replant.kernels.')}.{function.__name__}"
        self._compiled: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Run it, compiled unless `interpreted` says otherwise."""
        if _interpreted or isinstance(arguments[0], Fields):  # fields: the caller is interpreted, too
            return self.python(*self._fields(arguments))
        if self._compiled is None:
            self._compiled = library().kernel(self.name)
        return self._compiled(*arguments)

    def _fields(self, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the arguments as the function has them: a state is given as its five arrays."""
        if isinstance(arguments[0], Fields) or StateArrays not in self.python.__annotations__.values():
            return arguments
        return (StateArrays(*arguments[:5]).fields, *arguments[5:])


def kernel(*requirements: str) -> Callable[[Callable[..., Any]], Kernel]:
    """Return the decorator of what Python calls; each requirement, "models.size >= variances.size", must then hold."""

    def mark(function: Callable[..., Any]) -> Kernel:
        KERNELS.append(Kernel(function, requirements))
        return KERNELS[-1]

    return mark


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark what melts into its callers: a small part of a loop, where a call would cost more than it does."""
    return function


def short_loops(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a kernel whose loops, but for those over `side_by_side`, have too few passes to compute several at once."""
    return function


def side_by_side(end: int) -> range:
    """Return the passes of a loop of which none needs what another one has done: several may be computed at once."""
    return range(end)


def in_turn(first: int, end: int) -> range:
    """Return the passes of a loop that are computed one by one: several at once would take longer."""
    return range(first, end)


@contextmanager
def interpreted() -> Iterator[None]:
    """Run kernels as the Python functions that they are, a thousand times as slow: for tests."""
    global _interpreted
    kept, _interpreted = _interpreted, True
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        _interpreted = kept


class Api(ctypes.Structure):
    """What the library needs of Python, by name: it is linked with none, and serves every version."""

    NAMES = (
        "PyFloat_AsDouble", "PyFloat_FromDouble", "PyLong_AsLongLong", "PyLong_FromLongLong", "PyBool_FromLong",
        "PyObject_IsTrue", "PyTuple_New", "PyTuple_SetItem", "PyTuple_GetItem", "PyByteArray_AsString",
        "PyObject_GetBuffer", "PyBuffer_Release", "PyBuffer_IsContiguous", "PyErr_Occurred", "PyErr_Format",
        "PyErr_SetString", "PyEval_SaveThread", "PyEval_RestoreThread", "PyObject_CallFunctionObjArgs",
        "Py_DecRef",
    )  # fmt: skip
    _fields_ = [(name, ctypes.c_void_p) for name in NAMES]
    _fields_ += [("type_error", ctypes.py_object), ("value_error", ctypes.py_object)]
    _fields_ += [("contiguous", ctypes.py_object)]


class Library:
    """The native library, loaded."""

    def __init__(self, path: Path) -> None:
        try:
            self._library = ctypes.CDLL(str(path))
        except OSError as error:
            raise UnsupportedDependencyError(
                f"the compiled kernels, {path.name}, do not load ({error}): install replant again, or make build"
            ) from None
        for name in ("replant_source", "replant_name"):
            getattr(self._library, name).restype = ctypes.c_char_p
        for name in ("replant_call_definition", "replant_step_definition"):
            getattr(self._library, name).restype = ctypes.c_void_p
        self.source = self._library.replant_source().decode()
        names = [self._library.replant_name(number) for number in range(self._library.replant_count())]
        self._numbers = {name.decode(): number for number, name in enumerate(names)}
        self._step_numbers = {name.decode(): self._library.replant_step_number(name) for name in names}  # -1: no step
        found = {name: ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value for name in Api.NAMES}
        given = {"type_error": TypeError, "value_error": ValueError}
        self._api = Api(**found, **given, contiguous=np.ascontiguousarray)
        self._library.replant_connect(ctypes.byref(self._api))
        # a function of its own: `ctypes.pythonapi.PyCFunction_NewEx` belongs to the process
        made = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)
        self._new = made(("PyCFunction_NewEx", ctypes.pythonapi))

    def kernel(self, name: str) -> Callable[..., Any]:
        """Return a kernel."""
        return self._new(self._library.replant_call_definition(), self._numbers[name], None)  # type: ignore[no-any-return]

    def table(self, name: str, arrays: tuple[np.ndarray, ...]) -> bytearray:
        """Return the addresses and shapes of a state's arrays, for `step`."""
        # a call with five arrays takes longer than most steps: their types and shapes are looked up each time; the
        # arrays of a state do not move, so that a table replaces them
        numbers: list[int] = []
        for place, array in enumerate(arrays):
            kind = np.float64 if place else np.int64
            if array.dtype != kind or not (array.flags.c_contiguous and array.flags.writeable):
                raise ValueError(f"{name}: array {place} of the state is not {kind.__name__}, contiguous and writable")
            numbers += [array.__array_interface__["data"][0], *array.shape]
        number = self._step_numbers.get(name, -1)
        if number < 0 or len(numbers) != GATE:
            raise ValueError(f"{name} is no step kernel, or these are not the arrays of a state")
        return bytearray(np.array([*numbers, SHUT, number], np.int64).tobytes())

    def step(self, table: bytearray, arrays: tuple[np.ndarray, ...]) -> tuple[Callable[..., float], np.ndarray]:
        """Return a function of (u, y, t, r) that takes one sample by a step kernel, and its gate (1,), shut."""
        call = self._new(self._library.replant_step_definition(), (table, Attention, *arrays), None)
        return call, np.frombuffer(table, np.int64)[GATE : GATE + 1]


def library() -> Library:
    """Return the native library, built first where this is a clone whose kernels have changed."""
    # threads wait for the first of them; processes do not: each puts a whole library in its place
    with _loading:
        return _loaded()


@functools.cache
def _loaded() -> Library:
    builder = _builder()
    if builder is not None and _source_of(LIBRARY) != source_hash(FOLDER, builder):
        reason = "has changed" if LIBRARY.exists() else "is not compiled yet"
        if sys.stderr is not None:
            sys.stderr.write(f"replant: the source of the kernels {reason}: compiling it (once, some seconds)\n")
        _build(builder)
    if not LIBRARY.exists():
        raise UnsupportedDependencyError(
            f"replant is installed without its compiled kernels, {LIBRARY.name}: install it again, from a wheel for "
            "this system or with a C compiler: pip install --force-reinstall --no-deps replant"
        )
    return Library(LIBRARY)


def source_hash(kernels: Path, builder: Path) -> str:
    """Return the hash of all that the library is made from, and for: two systems may share a clone."""
    libc = getattr(sys.implementation, "_multiarch", "")  # tells musl from glibc
    digest = hashlib.sha256(f"{sys.platform} {platform.machine()} {libc}".encode())
    made_from = [*kernels.rglob("*.py"), *(path for suffix in ("py", "c", "h") for path in builder.glob(f"*.{suffix}"))]
    for path in sorted(path for path in made_from if not path.name.startswith(".")):  # an editor's locks are no source
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]


def _builder() -> Path | None:
    """Return the folder of the translator where this is a clone, else None."""
    root = FOLDER.parents[2]
    return root / "tools/translator" if (root / "tools/translator/library.py").exists() else None


def _source_of(path: Path) -> str:
    """Return the hash that a library carries, "" where there is none."""
    content = path.read_bytes() if path.exists() else b""
    _, found, rest = content.partition(b"replant-source:")
    return rest[:32].decode("ascii", "replace") if found else ""


def _build(builder: Path) -> None:
    import subprocess

    command = [sys.executable, str(builder / "library.py")]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["no reason given"]
        raise UnsupportedDependencyError(f"the kernels cannot be compiled: {said[-1]}")
