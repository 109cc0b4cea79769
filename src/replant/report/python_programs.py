"""The Python programs that reproduce the models of a report."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from replant.estimation.settings import Scaling, Settings
from replant.fitting.fit_result import FitResult
from replant.fitting.miso_model import RowModel
from replant.logs.conditioning import STEPS
from replant.logs.log import Log
from replant.online.runs.result import Result

WIDEST = 88  # width of a line [characters]


def identifier_as_python(settings: Settings) -> str:
    """Return the Python code that makes an identifier with these settings."""
    is_plain = settings.scaling == Scaling.none(settings.structure)
    parts = [
        f"    rp.{_call(settings.structure)}, dt={settings.dt!r},",
        f"    filter=rp.{_call(settings.filter)},",
        *(["    scaling=None,"] if is_plain else _broken("scaling", settings.scaling)),
        f"    optimizer=rp.{_call(settings.optimizer)},",
        f"    replay={'rp.' + _call(settings.replay) if settings.replay else None},",
        *(["    instruments=True,"] if settings.instruments else []),
        *([] if settings.normalize else ["    normalize=False,"]),
        *_broken("preprocess", settings.preprocess),
        *([f"    startup={settings.startup},"] if settings.instruments else []),
    ]
    return "\n".join(["ident = rp.Identifier(", *parts, ")"])


def run_as_python(result: Result, log: Log, opened: str = "") -> str:
    """Return the Python program that repeats an online run over ``log``; ``opened`` is its begin, see `opening`."""
    assert result.settings is not None
    lines = [
        identifier_as_python(result.settings),
        f"trace = ident.update_many({', '.join(_given(log, 'r'))})",
        *(["ident.finish()"] if result.finished else []),
        "print(ident.transfer_function)",
    ]
    return "\n".join([opened or _opened([log]), *lines])


def fit_as_python(fitted: FitResult, logs: Sequence[Log], opened: str = "") -> str:
    """Return the Python program that repeats an offline fit of logs; ``opened`` is its begin, see `opening`."""
    log, several = logs[0], len(logs) > 1
    if log.path.name:  # a log has its own clock, reference and hold of the input
        signals, others = "logs" if several else "log", list[str]()
    else:
        signals, *others = _given(log, "reference")
        signals = f"{signals}, dt={log.dt!r}"
    lines = [
        "fitted = rp.fit(",
        f"    {signals}, structure=rp.{_call(fitted.structure)}, method={fitted.method!r},",
        *(f"    {argument}," for argument in others),
        *([f"    filter=rp.{_call(fitted.filter.fixed)},"] if fitted.filter.fixed else []),
        f"    preprocess=rp.{_call(fitted.preprocess)},",
        ")",
        "print(fitted.transfer_function)",
    ]
    return "\n".join([opened or _opened(logs), *lines])


def row_as_python(model: RowModel, logs: Sequence[Log], startup: int | None = None, opened: str = "") -> str:
    """Return the Python program that fits a row to logs, or with ``startup`` identifies it in one pass over a log.

    ``opened`` is its begin, see `opening`.
    """
    each = model.structures
    orders = ", ".join(f"{name}={tuple(getattr(one, name) for one in each)!r}" for name in ("poles", "zeros", "delay"))
    log, several = logs[0], len(logs) > 1
    if startup is not None:
        references = [each for each in _given(log, "r") if each.startswith("r=")]
        lines = [
            f"ident = rp.Identifier({orders}, dt={log.dt!r}, startup={startup}, input_hold={log.input_hold!r})",
            f"trace = ident.update_many({', '.join(['log.inputs, log.output, log.stamps', *references])})",
            "ident.finish()",
            "print(ident.model)",
        ]
    else:
        lines = [f"fitted = rp.fit({'logs' if several else 'log'}, {orders})", "print(fitted)"]
    return "\n".join([opened or _opened(logs), *lines])


def changes_as_python(
    steps: Mapping[str, Any], left_out: Sequence[Any] = (), use: Sequence[Any] = (), *, at_rest: bool = False
) -> list[str]:
    """Return the calls that change a log as options do, in the order of the commands, with {} in the log's place.

    ``steps`` has the arguments of `STEPS`; ``left_out`` and ``use`` are stretches of time (begin, end).
    """
    calls = []
    for name in STEPS:
        given = steps.get(name)
        if given is None or given is False:
            continue
        arguments = () if given is True else given if isinstance(given, tuple) else (given,)
        called = "bandpass" if name == "band" else name
        calls.append(f"rp.{called}({', '.join(['{}', *map(repr, arguments)])})")
    if left_out or use:
        calls.append(f"rp.leave_out({{}}, {list(left_out)!r}{f', use={list(use)!r}' if use else ''})")
    return [*calls, *(["rp.from_rest({})"] if at_rest else [])]


def changed(name: str, calls: Sequence[str], several: str = "") -> list[str]:
    """Return the lines that change the log ``name``, or each of the list ``several``, by `changes_as_python`."""
    if several:
        return [f"{several} = [{call.format(name)} for {name} in {several}]" for call in calls]
    return [f"{name} = {call.format(name)}" for call in calls]


def opening(paths: Sequence[Any], columns: Mapping[str, Any], calls: Sequence[str] = ()) -> str:
    """Return the begin of a program: it reads one log or several by arguments of `read_log`, and changes them."""
    arguments = "".join(f", {name}={value!r}" for name, value in columns.items() if value is not None)
    return _begin([f"rp.read_log({str(path)!r}{arguments})" for path in paths], calls)


def _begin(reads: Sequence[str], calls: Sequence[str] = ()) -> str:
    several = len(reads) > 1
    read = ["logs = [", *(f"    {each}," for each in reads), "]"] if several else [f"log = {reads[0]}"]
    imported = ["import dataclasses", ""] if any(call.startswith("dataclasses.") for call in calls) else []
    return "\n".join([*imported, "import replant as rp", "", *read, *changed("log", calls, "logs" if several else "")])


def _given(log: Log, reference: str) -> list[str]:
    """Return the arguments for the signals and, if present, the stamps of an irregular clock and references."""
    is_read = bool(log.path.name)
    found = ["log.input, log.output" if is_read else "u, y"]
    if log.stamps is not None:
        found.append(f"t={'log.stamps' if is_read else 't'}")
    if log.reference_name:
        read = "log.references" if log.more_references else "log.reference"
        found.append(f"{reference}={read if is_read else 'r'}")
    return found


def _opened(logs: Sequence[Log]) -> str:
    """Return the start of a program, which reads one log or several."""
    log = logs[0]
    if log.path.name:
        return _begin(list(map(_read, logs)))
    arrays = ["u", "y", *(["t"] if log.stamps is not None else []), *(["r"] if log.reference_name else [])]
    read = f"# {', '.join(arrays)}: the record, {('two', 'three', 'four')[len(arrays) - 2]} arrays"
    return f"import replant as rp\n\n{read}"


def _read(log: Log) -> str:
    given = list(log.input_names) if log.more_inputs else log.input_name
    arguments = [repr(str(log.path)), f"input={given!r}", f"output={log.output_name!r}"]
    if log.reference_name:
        arguments.append(f"reference={list(log.reference_names) if log.more_references else log.reference_name!r}")
    more = {"dt": log.dt if log.time is None else None, "begin": log.begin, "end": log.end}
    arguments += [f"{name}={value!r}" for name, value in more.items() if value is not None]
    return f"rp.read_log({', '.join(arguments)})"


def _broken(name: str, value: Any) -> list[str]:
    """Return an argument as one line, or, if that is too long, one line for each of its own arguments."""
    line = f"    {name}=rp.{_call(value)},"
    if len(line) <= WIDEST:
        return [line]
    return [f"    {name}=rp.{type(value).__name__}(", *(f"        {part}," for part in _arguments(value)), "    ),"]


def _call(value: Any) -> str:
    """Return the call that makes a frozen dataclass, without defaults."""
    return f"{type(value).__name__}({', '.join(_arguments(value))})"


def _arguments(value: Any) -> list[str]:
    return [
        f"{field.name}={_argument(getattr(value, field.name))}"
        for field in dataclasses.fields(value)
        if getattr(value, field.name) != field.default
    ]


def _argument(value: Any) -> str:
    """Return a value as Python code, floats with six digits."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return "[" + ", ".join(_argument(entry) for entry in value) + "]"
    return getattr(value, "__name__", "") or repr(value) if callable(value) else repr(value)
