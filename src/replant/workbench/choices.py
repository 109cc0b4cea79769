"""The user's choices for a log and the requested models, also as a command line and as a Python program."""

from __future__ import annotations

import dataclasses
import math
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, Self

from replant.errors import InvalidArgumentError, shown
from replant.logs.conditioning import STEPS
from replant.numerics.limits import typed_path
from replant.report.python_programs import changed, changes_as_python

FIT, SEARCH, RUN = "fit", "search", "run"
KINDS = (FIT, SEARCH, RUN)
STRETCHES = ("use", "leave_out", "validate_on")
MOST_STRETCHES = 100  # most stretches of one kind [count]
MOST_CARDS = 24  # most models fitted by one click [count]
LONGEST = 200  # longest name or field of numbers [characters]
_WHOLE = r"\d{1,3}"
_SECONDS = r"(?:\d{1,9}(?:\.\d{0,12})?|\.\d{1,12})(?:e-?\d{1,2})?"


class Stretch(NamedTuple):
    """A stretch of time in s from the first sample; without an end it extends to the last sample."""

    begin: float
    end: float | None = None

    @property
    def written(self) -> str:
        """The value of a command-line option: 12.5:40, or 40: to the end."""
        return f"{plain(self.begin)}:{'' if self.end is None else plain(self.end)}"

    @classmethod
    def of(cls, given: Any) -> Self:
        """Return the stretch for [begin, end] from a page or a file."""
        if not isinstance(given, list | tuple) or len(given) != 2:
            raise InvalidArgumentError("a stretch must be [begin, end]")
        begin, end = max(_number("begin", given[0]), 0.0), None if given[1] is None else _number("end", given[1])
        if end is not None and not begin < end:
            raise InvalidArgumentError("a stretch of time must end after it begins: drag over some width")
        return cls(begin, end)


def plain(value: float) -> str:
    """Return a number with up to twelve digits and without a power of ten."""
    digits = f"{float(f'{value:.12g}'):.12f}"
    return digits.rstrip("0").rstrip(".") or "0"


@dataclass(frozen=True)
class Setup:
    """The options for reading and conditioning a log."""

    input: str = ""  # input, output, reference, time: columns, as in the command-line options; empty: none
    output: str = ""
    reference: str = ""
    time: str = ""
    dt: float | None = None  # sampling time in s, instead of a time column
    use: tuple[Stretch, ...] = ()
    leave_out: tuple[Stretch, ...] = ()
    validate_on: tuple[Stretch, ...] = ()
    detrend: bool = False
    decimate: int | None = None
    resample: float | None = None  # new sampling time in s

    def changed(self, given: dict[str, Any]) -> Self:
        """Return the setup with some fields replaced by values from a page or a file."""
        known = {field.name for field in fields(self)}
        return dataclasses.replace(self, **{name: _checked(name, given[name]) for name in known & set(given)})

    def with_stretch(self, kind: str, before: Any, after: Any) -> Self:
        """Return the setup with stretch ``before`` replaced by ``after``; None: add ``after``, or remove ``before``."""
        if kind not in STRETCHES:
            raise InvalidArgumentError(f"a stretch is one of {', '.join(STRETCHES)}, not {shown(kind)}")
        left = [each for each in getattr(self, kind) if before is None or each != Stretch.of(before)]
        return self.changed({kind: [*left, *([] if after is None else [after])]})

    def check(self) -> None:
        """Raise InvalidArgumentError if the setup does not suffice for a model."""
        if not (self.input and self.output):
            raise InvalidArgumentError("choose the columns of input and output first")
        if self.input == self.output:
            raise InvalidArgumentError("input and output are the same column: choose two")


@dataclass(frozen=True)
class Wish:
    """The requested models: numbers or ranges, as in the command-line options."""

    kind: str = FIT
    poles: str = "1:3"
    zeros: str = ""
    delay: str = "0"

    def changed(self, given: dict[str, Any]) -> Self:
        """Return the wish with some fields replaced by values from a page or a file."""
        known = {field.name for field in fields(self)}
        return dataclasses.replace(self, **{name: _wished(name, given[name]) for name in known & set(given)})

    @property
    def alone(self) -> tuple[Wish, ...]:
        """One wish for each model: `fit` and `run` make one for each number of a range, `search` chooses one."""
        if self.kind == SEARCH:
            return (self,)
        found = [
            dataclasses.replace(self, poles=p, zeros=z, delay=d)
            for p in numbers(self.poles)
            for z in (numbers(self.zeros) if self.zeros else [""])
            for d in numbers(self.delay)
            if not z or int(z) < int(p)
        ]
        if not found:
            raise InvalidArgumentError("zeros must be fewer than poles: choose fewer zeros or more poles")
        if len(found) > MOST_CARDS:
            raise InvalidArgumentError(
                f"{len(found)} models at once, the limit is {MOST_CARDS}: choose smaller ranges, or search instead"
            )
        return tuple(found)


def grid(text: str) -> list[float]:
    """Return the numbers of a range first:last or first:last:step, equal to the bit to the command line's."""
    parts = [float(part) for part in text.split(":")]
    if len(parts) == 1:
        return parts
    step = parts[2] if len(parts) > 2 else 1.0
    if not step > 0.0 or parts[1] < parts[0] or (parts[1] - parts[0]) / step > 1000:
        raise InvalidArgumentError(f"{text} is not a range; write 1:4, or 0:1:0.1")
    return [parts[0] + k * step for k in range(int((parts[1] - parts[0]) / step * (1 + 1e-12)) + 1)]


def numbers(text: str) -> list[str]:
    """Return the numbers of a range as text."""
    return [plain(value) for value in grid(text)] if ":" in text else [text]


def text(name: str, given: Any) -> str:
    """Check that a value is a text of at most `LONGEST` characters."""
    if not isinstance(given, str) or len(given) > LONGEST:
        raise InvalidArgumentError(f"{name} must be a text of at most {LONGEST} characters")
    return given


def _wished(name: str, given: Any) -> str:
    value = text(name, given).replace(" ", "")
    if name == "kind":
        if value not in KINDS:
            raise InvalidArgumentError(f"kind must be one of {', '.join(KINDS)}, got {shown(value)}")
        return value
    number = _SECONDS if name == "delay" else _WHOLE
    if value == "" and name != "poles":
        return "" if name == "zeros" else "0"
    if not re.fullmatch(f"{number}(?::{number}){{0,2}}", value):
        example = "0.02, or 0:0.1:0.02, with a decimal point" if name == "delay" else "2, or 1:4"
        raise InvalidArgumentError(f"{name} {shown(value)}: write {example}")
    grid(value)  # raises if it is not a range
    return value


def _checked(name: str, given: Any) -> Any:
    if name in ("input", "output", "reference", "time"):
        return text(name, given)
    if name in STRETCHES:
        return _stretches(given)
    if name == "detrend":
        return bool(given)
    if given is None:
        return None
    value = _number(name, given)
    if name == "decimate":
        if value != int(value) or not 2 <= value <= 1e6:
            raise InvalidArgumentError("the decimation factor must be a whole number from 2 to 1000000")
        return int(value)
    if not 0.0 < value < math.inf:
        raise InvalidArgumentError(f"{'the sampling time' if name == 'dt' else name} must be above 0 s")
    return value


def _stretches(given: Any) -> tuple[Stretch, ...]:
    if not isinstance(given, Iterable) or isinstance(given, str):
        raise InvalidArgumentError("stretches must be a list of [begin, end]")
    found = sorted({Stretch.of(each) for each in given}, key=lambda each: (each.begin, each.end or math.inf))
    if len(found) > MOST_STRETCHES:
        raise InvalidArgumentError(f"at most {MOST_STRETCHES} stretches of one kind are possible: join some")
    return tuple(found)


def _number(name: str, given: Any) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not abs(given) < 1e15:
        raise InvalidArgumentError(f"{name} must be a number, got {shown(given)}")
    return float(given)


def words_of(path: Path, setup: Setup, wish: Wish) -> tuple[str, ...]:
    """Return the arguments of ``replant`` for a model; a job runs exactly these."""
    clock = ("--time", setup.time) if setup.dt is None else ("--dt", f"{setup.dt:.12g}")
    options = [
        ("-i", setup.input), ("-o", setup.output), ("--reference", setup.reference), clock,
        ("-p", wish.poles), ("--zeros", wish.zeros), ("--delay", "" if wish.delay == "0" else wish.delay),
        ("--resample", "" if setup.resample is None else f"{setup.resample:.12g}"),
        ("--decimate", str(setup.decimate or "")),
    ]  # fmt: skip
    stretches = [(f"--{name.replace('_', '-')}", each.written) for name in STRETCHES for each in getattr(setup, name)]
    words = [word for option, value in options if value for word in (option, value)]
    words += ["--detrend"] if setup.detrend else []
    return (RUN if wish.kind == RUN else "fit", typed_path(path), *words, *chain.from_iterable(stretches))


def command_line(words: tuple[str, ...], saved: str = "model.json") -> str:
    """Return the command line that writes the model into a file."""
    return shlex.join(["replant", *words, "--save", saved])


def program(path: Path, setup: Setup, wish: Wish, saved: str = "model.json") -> str:
    """Return the Python program that makes the same model to the bit, by the steps of the command."""
    lines = ["import dataclasses", "import sys", ""]
    lines += [
        "import replant as rp",
        "from replant.fitting.log_inspection import with_others",
        "from replant.logs import open_recording",
        "from replant.logs.recording import digest",
        *(["from replant.online.runs.run_log import judged_by_log"] if wish.kind == RUN else []),
        "",
        f"path = {str(path)!r}",
        f"recording = with_others(open_recording(path, {_columns(setup)}, most_held=sys.maxsize))",
        "log = dataclasses.replace(recording.held, sha256=digest(recording.path))",
    ]
    steps = {name: getattr(setup, name, None) for name in STEPS}
    # as many digits as the command has
    steps = {name: float(f"{given:.12g}") if isinstance(given, float) else given for name, given in steps.items()}
    left_out, use = ([tuple(each) for each in given] for given in (setup.leave_out + setup.validate_on, setup.use))
    lines += changed("log", changes_as_python(steps, left_out, use))
    return "\n".join([*lines, f"model = {_model(wish)}", f"model.save({saved!r})", "print(model)"]) + "\n"


def _columns(setup: Setup) -> str:
    named = [f"input={setup.input!r}", f"output={setup.output!r}"]
    named += [f"reference={setup.reference!r}"] if setup.reference else []
    if setup.dt is not None:
        return ", ".join([*named, f"dt={float(f'{setup.dt:.12g}')!r}"])
    return ", ".join([*named, *([f"time={setup.time!r}"] if setup.time else [])])


def _model(wish: Wish) -> str:
    if wish.kind == SEARCH:
        poles, zeros = (f"[{', '.join(numbers(given))}]" if given else "" for given in (wish.poles, wish.zeros))
        zeros = zeros or ("" if ":" in wish.poles else "[0]")
        more = f", zeros={zeros}" if zeros else ""
        return f"rp.search(log, poles={poles}{more}, delays={grid(wish.delay)!r}).best.model"
    size = f"poles={wish.poles}, zeros={wish.zeros or 0}, delay={float(wish.delay)!r}"
    return f"judged_by_log(rp.run(log, {size}), log).model" if wish.kind == RUN else f"rp.fit(log, {size}).model"
