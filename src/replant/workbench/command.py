"""A model as it is asked for, in the two forms that make it again: the command line, and a Python program."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

from replant.data.conditioning import STEPS
from replant.workbench.setup import RUN, SEARCH, STRETCHES, Setup, Stretch, Wish, numbers


def words_of(path: Path, setup: Setup, wish: Wish) -> tuple[str, ...]:
    """Return the words of the command line behind ``replant``: a job runs these very words.

    >>> words_of(Path("/logs/motor.csv"), Setup("u", "y", leave_out=(Stretch(10.0, 12.0),)), Wish(poles="2"))[1:]
    ('/logs/motor.csv', '-i', 'u', '-o', 'y', '-p', '2', '--leave-out', '10:12')
    """
    return (RUN if wish.kind == RUN else "fit", str(path), *_read(setup), *_wished(wish), *_changed(setup))


def command_line(words: tuple[str, ...], saved: str = "model.json") -> str:
    """Return the command line that writes the model into a file.

    >>> command_line(("fit", "my log.csv", "-p", "1"))
    "replant fit 'my log.csv' -p 1 --save model.json"
    """
    return shlex.join(["replant", *words, "--save", saved])


def _read(setup: Setup) -> Iterator[str]:
    for option, value in (("-i", setup.input), ("-o", setup.output), ("--reference", setup.reference)):
        if value:
            yield from (option, value)
    if setup.dt is not None:
        yield from ("--dt", f"{setup.dt:.12g}")
    elif setup.time:
        yield from ("--time", setup.time)


def _wished(wish: Wish) -> Iterator[str]:
    yield from ("-p", wish.poles)
    if wish.zeros:
        yield from ("--zeros", wish.zeros)
    if wish.delay != "0":
        yield from ("--delay", wish.delay)


def _changed(setup: Setup) -> Iterator[str]:
    if setup.resample is not None:
        yield from ("--resample", f"{setup.resample:.12g}")
    if setup.decimate is not None:
        yield from ("--decimate", str(setup.decimate))
    if setup.detrend:
        yield "--detrend"
    for name in STRETCHES:
        for stretch in getattr(setup, name):
            yield from (f"--{name.replace('_', '-')}", stretch.written)


def program(path: Path, setup: Setup, wish: Wish, saved: str = "model.json") -> str:
    """Return the Python program that makes the same model to the bit: the steps of the command, one by one."""
    lines = [
        *_imports(setup, wish),
        "",
        f"path = {str(path)!r}",
        f"recording = with_others(open_recording(path, {_columns(setup)}, most_held=sys.maxsize))",
        "log = dataclasses.replace(recording.held, sha256=digest(recording.path))",
        *_conditioning(setup),
        *_cut(setup),
        *_model(wish),
        f"model.save({saved!r})",
        "print(model)",
    ]
    return "\n".join(lines) + "\n"


def _imports(setup: Setup, wish: Wish) -> Iterator[str]:
    yield from ("import dataclasses", "import sys", "")
    if any(getattr(setup, name) for name in STRETCHES):
        yield from ("import numpy as np", "")
    yield "import replant as rp"
    yield "from replant.data.inspection.inspect import with_others"
    yield "from replant.data.logs import open_recording"
    yield "from replant.data.logs.recording import digest"
    if wish.kind == RUN:
        yield "from replant.runs.run_log import judged_by_log"


def _columns(setup: Setup) -> str:
    named = [f"input={setup.input!r}", f"output={setup.output!r}"]
    named += [f"reference={setup.reference!r}"] if setup.reference else []
    if setup.dt is not None:
        return ", ".join([*named, f"dt={float(f'{setup.dt:.12g}')!r}"])
    return ", ".join([*named, *([f"time={setup.time!r}"] if setup.time else [])])


def _conditioning(setup: Setup) -> Iterator[str]:
    for name in STEPS:
        given = getattr(setup, name, None)
        if given is True:
            yield f"log = rp.{name}(log)"
        elif given is not None and given is not False:
            yield f"log = rp.{name}(log, {float(f'{given:.12g}') if isinstance(given, float) else given!r})"


def _cut(setup: Setup) -> Iterator[str]:
    """Yield the lines that leave outputs out; the input goes on to act."""
    if not any(getattr(setup, name) for name in STRETCHES):
        return
    yield "t = log.dt * np.arange(len(log)) if log.time is None else log.time - log.time[0]"
    used = " | ".join(map(_within, setup.use))
    yield f"used = {used or 'np.ones(len(log), bool)'}"
    for stretch in (*setup.leave_out, *setup.validate_on):
        yield f"used &= ~{_within(stretch)}"
    yield "log = dataclasses.replace(log, output=np.where(used, log.output, np.nan))"


def _within(stretch: Stretch) -> str:
    begin, end = stretch.written.split(":")
    return f"(t >= {begin})" if not end else f"((t >= {begin}) & (t < {end}))"


def _model(wish: Wish) -> Iterator[str]:
    if wish.kind == SEARCH:
        poles, zeros = _list(wish.poles), _list(wish.zeros) if wish.zeros else None
        if zeros is None and ":" not in wish.poles:
            zeros = "[0]"
        delays = f"[{', '.join(repr(value) for value in _grid(wish.delay))}]"
        more = f", zeros={zeros}" if zeros else ""
        yield f"model = rp.search(log, poles={poles}{more}, delays={delays}).best.model"
        return
    size = f"poles={wish.poles}, zeros={wish.zeros or 0}, delay={float(wish.delay)!r}"
    if wish.kind == RUN:
        yield f"model = judged_by_log(rp.run(log, {size}), log).model"
    else:
        yield f"model = rp.fit(log, {size}).model"


def _list(text: str) -> str:
    return f"[{', '.join(numbers(text))}]"


def _grid(text: str) -> list[float]:
    """Return the dead times of a range to the bit as the command line has them."""
    parts = [float(part) for part in text.split(":")]
    if len(parts) == 1:
        return parts
    step = parts[2] if len(parts) > 2 else 1.0
    return [parts[0] + k * step for k in range(int((parts[1] - parts[0]) / step * (1 + 1e-12)) + 1)]
