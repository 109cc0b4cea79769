"""Calls of kernels from Python: compiled to a native library by the build, or interpreted.

`kernel` marks a function that Python calls.  Its annotations are the types of the arguments; its requirements are
conditions on their lengths.  The library checks both before a kernel runs: a wrong argument is an error, never a crash.

In a clone the library is compiled by the build, and again here, in seconds, if the kernels have changed since.
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
from replant.kernels.schema import Attention, StateSlots
from replant.kernels.slot_tables import Fields

States = tuple[StateSlots, ...]  # of LANES members, which Python gives as their arrays one after the other
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
# after the addresses and shapes of five arrays; behind it the number of the step kernel
GATE = 13  # place of the gate in a step's table [index]
OPEN, SHUT = 0, 1  # values of the gate: samples are taken, or refused because another call is running [number]

# Conditions on the arrays of a state, see `replant.kernels.step.soundness`.
LAID_OUT: Final = "is_laid_out(s, s.reals.size, s.banks.shape[0], s.banks.shape[1])"
IS_SOUND: Final = "is_sound(s)"
#: For kernels that need an estimate: `is_sound` does not check everything while the state still collects samples.
LEARNS: Final = "not s.collects"
#: For kernels that take many samples.
AS_MANY: Final = (
    "y.size == u.size and errors.size >= u.size",
    "(t.size == 0 or t.size == u.size) and (r.size == 0 or r.size == u.size)",
    "parameters.shape[0] >= u.size and 0 <= parameters.shape[1] <= s.entries",
)

_interpreted = False
_loading = threading.Lock()


class Kernel:
    """A kernel that Python calls; `python` is the function in Python."""

    def __init__(self, function: Callable[..., Any], requirements: tuple[str, ...]) -> None:
        functools.update_wrapper(self, function)
        self.python, self.requirements = function, requirements
        self.name = f"{function.__module__.removeprefix('replant.kernels.')}.{function.__name__}"
        self._compiled: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Run the compiled kernel, or the Python function within `interpreted`."""
        if _interpreted or isinstance(arguments[0], Fields):  # a caller that passes fields is itself interpreted
            return self.python(*self._fields(arguments))
        if self._compiled is None:
            self._compiled = library().kernel(self.name)
        return self._compiled(*arguments)

    def _fields(self, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the arguments of the Python function: the five arrays of a state become its fields."""
        if isinstance(arguments[0], Fields) or StateSlots not in self.python.__annotations__.values():
            return arguments
        return (StateSlots(*arguments[:5]).fields, *arguments[5:])


def kernel(*requirements: str) -> Callable[[Callable[..., Any]], Kernel]:
    """Return the decorator of a kernel; the library checks its requirements, e.g. "models.size >= variances.size"."""

    def mark(function: Callable[..., Any]) -> Kernel:
        KERNELS.append(Kernel(function, requirements))
        return KERNELS[-1]

    return mark


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function to be inlined: a small part of a loop, where the call would cost more than its body."""
    return function


def short_loops(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a kernel whose loops, except those over `side_by_side`, have too few passes to be vectorised."""
    return function


def side_by_side(end: int) -> range:
    """Return the passes of a loop that do not depend on each other: the compiler may vectorise it."""
    return range(end)


def in_turn(first: int, end: int) -> range:
    """Return the passes of a loop that is not vectorised, as that would be slower."""
    return range(first, end)


@contextmanager
def interpreted() -> Iterator[None]:
    """Run kernels as Python functions, a thousand times slower: for tests."""
    global _interpreted
    kept, _interpreted = _interpreted, True
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        _interpreted = kept


class Api(ctypes.Structure):
    """The functions of CPython that the library uses: it links to no libpython, and fits any version."""

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
        # a separate prototype: setting the types of `ctypes.pythonapi.PyCFunction_NewEx` would change it process-wide
        made = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)
        self._new = made(("PyCFunction_NewEx", ctypes.pythonapi))

    def kernel(self, name: str) -> Callable[..., Any]:
        """Return a compiled kernel by its name."""
        return self._new(self._library.replant_call_definition(), self._numbers[name], None)  # type: ignore[no-any-return]

    def table(self, name: str, arrays: tuple[np.ndarray, ...]) -> bytearray:
        """Return the addresses and shapes of a state's arrays, for `step`."""
        # checking types and shapes of five arrays takes longer than most steps; the arrays of a state do not move, so
        # a table of their addresses replaces them
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
        """Return a function of (u, y, t, r) that takes one sample with a step kernel, and its gate (1,), shut."""
        call = self._new(self._library.replant_step_definition(), (table, Attention, *arrays), None)
        return call, np.frombuffer(table, np.int64)[GATE : GATE + 1]


def library() -> Library:
    """Return the native library; in a clone, compile it first if the kernels have changed."""
    # threads wait for the one that compiles; processes need not, as each replaces the file by a complete library
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
    """Return the hash of the library's sources and of the platform: two systems may share a clone."""
    libc = getattr(sys.implementation, "_multiarch", "")  # distinguishes musl from glibc
    digest = hashlib.sha256(f"{sys.platform} {platform.machine()} {libc}".encode())
    made_from = [*kernels.rglob("*.py"), *(path for suffix in ("py", "c", "h") for path in builder.glob(f"*.{suffix}"))]
    for path in sorted(path for path in made_from if not path.name.startswith(".")):  # not an editor's lock files
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]


def _builder() -> Path | None:
    """Return the folder of the translator in a clone, else None."""
    root = FOLDER.parents[2]
    return root / "tools/translator" if (root / "tools/translator/library.py").exists() else None


def _source_of(path: Path) -> str:
    """Return the source hash stored in a library, "" if there is none."""
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
