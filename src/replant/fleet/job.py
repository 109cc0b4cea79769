"""The job of a fleet: its options, the shape of its models, its rigs and tasks, and the files of its folder."""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from replant.errors import InvalidArgumentError, SystemRefusedError
from replant.estimation.optimizers import Optimizer
from replant.estimation.settings import AUTO, Request
from replant.fitting.miso_fit import structures_of
from replant.logs.arrow import RowGroups
from replant.logs.log import check_one_reference
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics import operating_system
from replant.numerics.arguments import finite, instance, iterable, keep, one_of, text, whole
from replant.numerics.limits import duration
from replant.numerics.operating_system import refusal


@dataclass(frozen=True)
class Shape:
    """The structure of a fleet's models, or one structure for each of several inputs."""

    structures: tuple[Structure, ...]
    inputs: tuple[str, ...] = ()  # names of several inputs; columns of the table then end in a dot and the name

    @classmethod
    def of(cls, structure: Structure | tuple[Structure, ...], inputs: Any) -> Shape:
        """Return the shape of models of a structure, or of one for each of several inputs."""
        return cls((structure,)) if isinstance(structure, Structure) else cls(structure, tuple(map(str, inputs)))

    @property
    def branches(self) -> list[tuple[str, str, Structure]]:
        """For each input its name, the ending of its columns, and its structure; both are empty for a single input."""
        named = [(name, f".{name}") for name in self.inputs] or [("", "")]
        return [(*each, structure) for each, structure in zip(named, self.structures, strict=True)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, one input after the other."""
        return tuple(f"{name}{end}" for _, end, structure in self.branches for name in structure.names)

    @property
    def coefficients(self) -> int:
        """Number of parameters that are coefficients."""
        return sum(each.coefficients for each in self.structures)

    def __str__(self) -> str:
        return ", ".join(f"{each} from {name}" if name else str(each) for name, _, each in self.branches)


def wanted(
    inputs: Any, structure: Structure | Sequence[Structure] | None, poles: Any, zeros: Any, delay: Any
) -> Structure | tuple[Structure, ...]:
    """Return the requested structure, a tuple for several inputs.

    >>> [each.poles for each in wanted(["u1", "u2"], None, (2, 1), 0, 0.0)]
    [2, 1]
    """
    if not iterable(inputs):
        if poles is not None and iterable(poles):
            raise InvalidArgumentError(f"poles has {len(poles)} entries for one input: name the other inputs, too")
        return Structure.wanted(structure, poles, zeros, delay)  # type: ignore[arg-type]
    if structure is None:
        return structures_of(len(inputs), poles, zeros, delay)
    given = (structure,) if isinstance(structure, Structure) else tuple(structure)
    structures = tuple(instance("structure", each, Structure) for each in given)
    if len(structures) != len(inputs):
        raise InvalidArgumentError(f"structure must be one for each of {len(inputs)} inputs, got {len(structures)}")
    if any(each.bias or each.feedthrough for each in structures):
        raise InvalidArgumentError("several inputs take no bias and no feedthrough yet: leave them out")
    return structures


METHODS = ("run", "fit")
FORMAT = 4  # version of a fleet's files; files of another version are made anew [number]


@dataclass(frozen=True)
class Job:
    """The options of identification for every rig, as of `replant.run` and `replant.fit`; tuples for several inputs."""

    input: str | int | tuple[str | int, ...]
    output: str | int
    structure: Structure | tuple[Structure, ...]
    method: str = "run"
    reference: str | int | tuple[str | int, ...] | None = None
    time: str | int | None = None
    dt: float | None = None
    begin: float | None = None
    end: float | None = None
    input_map: str = "identity"
    optimizer: Optimizer | str = AUTO

    def __post_init__(self) -> None:
        keep(self, "input", _columns)
        keep(self, "output", _column)
        if isinstance(self.input, tuple):
            for each in self.input:
                if self.input.count(each) > 1:
                    raise InvalidArgumentError(f"input {each!r} is given twice: name each column once")
            object.__setattr__(self, "structure", wanted(self.input, self.structure, None, 0, 0.0))
            for name, usual in (("input_map", "identity"), ("optimizer", AUTO)):
                if getattr(self, name) != usual:
                    raise InvalidArgumentError(f"several inputs take no {name} yet: leave it out")
        else:
            keep(self, "structure", instance, Structure)
        optional: dict[str, Any] = {
            "reference": _columns, "time": _column, "dt": duration, "begin": finite, "end": finite,
        }  # fmt: skip
        for name, check in optional.items():
            if getattr(self, name) is not None:
                keep(self, name, check)
        if isinstance(self.reference, tuple) and not self.several:
            check_one_reference(len(self.reference))
        if self.dt is not None and self.time is not None:
            raise InvalidArgumentError("give either the time column (time, --time) or the sampling time (dt, --dt)")
        keep(self, "method", one_of, METHODS)
        keep(self, "input_map", one_of, ("identity", "square"))
        if self.method == "fit" and self.optimizer != AUTO:
            raise InvalidArgumentError("only the method run takes an optimizer: leave it out, or use the method run")
        if self.method == "run" and not self.several:
            self.request(1.0 if self.dt is None else self.dt)  # raises if the options are invalid for every rig

    @property
    def several(self) -> bool:
        """Whether there are several inputs."""
        return isinstance(self.input, tuple)

    @property
    def shape(self) -> Shape:
        """The shape of the models."""
        return Shape.of(self.structure, self.input)

    def request(self, dt: float) -> Request:
        """Return the request for an identifier of one input with the sampling time ``dt`` in s."""
        assert isinstance(self.structure, Structure)
        return Request(self.structure, dt, optimizer=self.optimizer, preprocess=self.preprocess)

    @property
    def preprocess(self) -> Preprocess:
        """Input map and working point; the latter is the record's mean, as a rig is rarely at rest at zero."""
        return Preprocess(self.input_map, "mean", "mean")

    @property
    def key(self) -> str:
        """Digest of all options and of replant's version; if it changes, all rigs are identified again."""
        return digest(FORMAT, version("replant"), self)


@dataclass(frozen=True)
class Piece:
    """A file of a rig, or a part of one."""

    path: str  # absolute path
    name: str  # path relative to the folder of all logs
    size: int  # size, modified: in bytes, and in ns since 1970
    modified: int
    groups: tuple[int, ...] | None = None  # row groups of a Parquet file; None: the whole file
    rows: int = 0  # rows of those groups; 0 if unknown
    column: str = ""
    # the value of ``column`` in the rig's rows; if ``column`` is empty, all rows are the rig's
    key: str | int | None = None
    problem: str = ""  # why the piece cannot be identified, if known beforehand

    @property
    def row_groups(self) -> RowGroups:
        """Its rows in a Parquet file."""
        return RowGroups(Path(self.path), self.groups, self.column, self.key)


@dataclass(frozen=True)
class Rig:
    """A rig: its name, and the files with its samples."""

    name: str
    pieces: tuple[Piece, ...] = field(repr=False)

    @property
    def problem(self) -> str:
        """Why the rig cannot be identified, if known beforehand."""
        return next((piece.problem for piece in self.pieces if piece.problem), "")

    @property
    def fingerprint(self) -> str:
        """Digest of names, sizes and times of its files; if it changes, the rig is identified again."""
        told = [(one.name, one.size, one.modified, one.groups, one.column, one.key) for one in self.pieces]
        return digest(sorted(map(repr, told)))


def _column(name: str, value: Any) -> str | int:
    return text(name, value) if isinstance(value, str) else whole(name, value, 0, sys.maxsize)


def _columns(name: str, value: Any) -> str | int | tuple[str | int, ...]:
    if not iterable(value):
        return _column(name, value)
    if not value:
        raise InvalidArgumentError(f"{name} must name a column, got none")
    return tuple(_column(name, each) for each in value)


def digest(*told: object) -> str:
    """Return a digest of values by their repr."""
    return hashlib.sha256(repr(told).encode()).hexdigest()[:20]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the temporary name for writing a file, see `numerics.operating_system.replacing`."""
    try:
        with operating_system.replacing(path) as new:
            yield new
    except OSError as error:
        raise SystemRefusedError(f"{path} cannot be written: {refusal(error)}") from error


def printable(text: str) -> str:
    """Escape the bytes of a file's name that are not UTF-8, as tables require."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


TABLE, TIMING, MODELS, ABOUT = "rigs.parquet", "timing.parquet", "models.jsonl", "fleet.json"
STORE, REPORTS = "fleet.sqlite", "reports"
BEFORE = Path("manifest", ".lock")  # older versions of replant wrote this instead of `STORE`


def is_results(folder: Path) -> bool:
    """Return whether a fleet has written into a folder, even if it is not finished."""
    return any((folder / name).is_file() for name in (ABOUT, STORE, BEFORE))


def job_key(folder: Path) -> str:
    """Return the key of the job whose results a folder has, see `Job.key`; empty without results."""
    try:
        return str(json.loads((folder / ABOUT).read_text(encoding="utf-8"))["job"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def report_path(rig: str) -> str:
    """Return the path of a rig's report in the fleet's folder, unique also for rigs with similar names."""
    plain = re.sub(r"[^A-Za-z0-9]+", "-", rig).strip("-")[:60]
    return f"{REPORTS}/{plain}-{digest(rig)[:6]}.html"


FIXED = 100_000  # work for a rig that does not depend on its length, by benchmarks/fleet [equivalent samples]
TEXT_ROW, BINARY_ROW = 24, 12  # usual size of a row of time, input and output in text, and in other formats [bytes]
FEWEST, LARGEST = 64, 20_000_000  # intended number of tasks, and most work of a task: about a minute [count, samples]


def work_of(rig: Rig) -> int:
    """Return the work for a rig in equivalent samples."""
    rows = 0
    for piece in rig.pieces:
        suffix = Path(piece.path).suffix.lower()
        is_text = suffix in (".csv", ".txt", ".tsv", ".dat", ".lvm", ".jsonl")
        rows += piece.rows or piece.size // (TEXT_ROW if is_text else BINARY_ROW)
    return FIXED + rows


def planned(rigs: Sequence[Rig]) -> list[tuple[Rig, ...]]:
    """Group rigs, which are sorted by name, into tasks; return the tasks with the most work first."""
    share, before = min(LARGEST, sum(map(work_of, rigs)) / FEWEST), 0
    groups: dict[int, list[Rig]] = {}
    for rig in rigs:
        work = work_of(rig)
        groups.setdefault(int((before + work / 2) // share), []).append(rig)
        before += work
    return sorted(map(tuple, groups.values()), key=lambda group: -sum(map(work_of, group)))
