"""What to do next: it follows from the gravest reason of the verdict, as a sentence and a command that runs."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import click
import numpy as np

from replant.cli.conditioning_options import REST
from replant.cli.option_types import typed, typed_words
from replant.fitting.log_inspection import rounded_up
from replant.logs.column_roles import prepared, response
from replant.logs.log import Log
from replant.logs.sampling_time import time_candidates
from replant.numerics.arguments import FloatArray
from replant.numerics.limits import typed_path
from replant.online.runs.result import Result

TRIED = 6  # dead times of a suggested range, without 0 [count]
STEPS_OF_A_TEST = 2  # moves of the input in a step test: up, and down again [count]
UNSURE = r"has a standard deviation|uncertainty of (?:the estimate|its transfer)|cancel the poles?"
FEWER = r"with fewer poles the record is likelier(?:: ask for (\d+|one) pole)?"
COLUMN = r"^column (.+) explains"
OTHER_LOG = "LOG2"  # stands for a log that is not there yet


@dataclass(frozen=True)
class NextStep:
    """What to do next: in words, and as a command."""

    words: str
    command: str


@dataclass(frozen=True, eq=False)
class Situation:
    """The request and its result."""

    result: Result
    log: Log
    path: str  # the log as it was typed
    reason: str  # the reason of the verdict that the step follows from
    is_searched: bool  # whether the structure was searched for already

    @property
    def poles(self) -> int:
        """Poles of the model."""
        return self.result.structure.poles


def next_step(result: Result, log: Log, path: str, *, is_searched: bool) -> NextStep:
    """Return what to do next with a model, by the first reason of its verdict that has an answer."""
    situation = Situation(result, log, path, "", is_searched)
    if result.verdict.status == "trusted":
        return _keep(situation)
    for reason in result.verdict.reasons:
        step = next((step for phrase, step in STEPS if re.search(phrase, reason)), _keep)
        if step is not _keep:  # a reason to keep a model does not make one usable that others speak against
            return step(replace(situation, reason=reason))
    return _look(situation)


def dead_times(result: Result, log: Log) -> str:
    """Return a range of dead times to try: up to 1.5 times the delay of the response, or half a time constant."""
    seen = response(prepared(log.input), prepared(log.output))
    delay = 0.0 if seen is None else 1.5 * seen.delay * log.dt
    times = [mode.time_constant for mode in result.transfer_function.modes if math.isfinite(mode.time_constant)]
    slowest = min(max(map(abs, times), default=0.0), log.duration / 10.0)
    step = rounded_up(max(delay, 0.5 * slowest, TRIED * log.dt) / TRIED)
    return f"0:{TRIED * step:.6g}:{step:.6g}"


def again(*without: str, **options: object) -> str:
    """Return the command as it was typed, without some options, and with others."""
    words = [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    names = {name.replace("_", "-") for name in options}
    return shlex.join([*typed_words(without=(*without, *names)), *words])


def _look(situation: Situation, words: str = "look at the columns of the log") -> NextStep:
    return NextStep(words, shlex.join(["replant", "look", typed_path(situation.path), "--out", "look"]))


def _fit(*without: str) -> list[str]:
    """Return the words of the command that fits what was typed, without some options."""
    return ["replant", "fit", *typed_words(without=(*without, "optimizer", "startup"))[2:]]


def _keep(situation: Situation) -> NextStep:
    likelier = [fewer for reason in situation.result.verdict.reasons if (fewer := _likelier(reason))]
    words = f"keep the model{f', or try {_counted(likelier[0])}' if likelier else ''}"
    others = [found[1] for reason in situation.result.verdict.reasons if (found := re.search(COLUMN, reason))]
    words += f", knowing that column {others[0]} moves the output, too" if others else ""
    changed: dict[str, object] = {}
    if situation.is_searched:  # the structure that was found, in place of the ranges
        structure = situation.result.structure
        changed = {"poles": structure.poles, "zeros": structure.zeros, "delay": f"{structure.delay:.6g}"}
    return NextStep(f"{words}; check it on another log", again(**changed, save="model.json", validate=OTHER_LOG))


def _search(situation: Situation) -> NextStep:
    if situation.is_searched and re.fullmatch(r"\d+", typed("--poles")):  # dead times were searched for, orders not
        return NextStep("search the number of poles, too", again("poles", poles=f"1:{min(situation.poles + 2, 4)}"))
    if situation.is_searched:
        half = 0.5 * situation.log.duration
        words = "no structure explains the whole record; the plant may change: identify one half by itself"
        return NextStep(words, again("poles", "zeros", "delay", to=f"{half:.6g}", poles=situation.poles))
    delays = dead_times(situation.result, situation.log)
    searched = ["--poles", f"1:{min(situation.poles + 1, 4)}", "--delay", delays]
    command = shlex.join([*_fit("poles", "zeros", "delay", "method"), *searched])
    return NextStep("search the structure and the dead time", command)


def _wait(_: Situation) -> NextStep:
    if click.get_current_context().info_name == "fit":  # which has used all samples
        return _more()
    return NextStep("use all samples at once", shlex.join(_fit()))


def _more() -> NextStep:
    words = _fit()
    return NextStep("record more, and fit both logs", shlex.join([*words[:3], OTHER_LOG, *words[3:]]))


def _dead_time(situation: Situation) -> NextStep:
    found = re.search(r"dead time of ([\d.e+-]+) s", situation.reason)
    return _search(situation) if found is None else NextStep("set the dead time", again(delay=found[1]))


def _without_stamps(situation: Situation) -> NextStep:
    found = re.search(r"in their place, dt = ([\d.e+-]+) s", situation.reason)
    given = {} if found is None else {"dt": found[1]}
    return NextStep("give the sampling time in place of the stamps", again("time", **given))


def _fewer(situation: Situation) -> NextStep:
    if situation.poles > 1:
        fewer = _likelier(situation.reason) or situation.poles - 1
        return NextStep(f"try {_counted(fewer)}", again("poles", "zeros", poles=fewer))
    if _is_step_test(situation.log.input) and click.get_current_context().params.get("x0") != REST:
        return _at_rest(situation)
    return _more()


def _is_step_test(u: FloatArray) -> bool:
    """Return whether an input (K,) has moved from rest, and no more often than in a step test."""
    return bool(0 < np.count_nonzero(np.diff(u[np.isfinite(u)])) <= STEPS_OF_A_TEST)


def _likelier(reason: str) -> int:
    """Return the smaller number of poles that a reason proposes; 0 if it proposes none."""
    found = re.search(FEWER, reason)
    return 0 if found is None or found[1] is None else 1 if found[1] == "one" else int(found[1])


def _counted(poles: int) -> str:
    return "one pole" if poles == 1 else f"{poles} poles"


def _part(situation: Situation) -> NextStep:
    ago = re.search(r"changed ([\d.,e+-]+) s before the end", situation.reason)
    seconds = 0.5 * situation.log.duration if ago is None else float(ago[1].replace(",", ""))
    begin = max(situation.log.duration - seconds, 0.0) + (situation.log.begin or 0.0)
    words = "identify the newest half by itself" if ago is None else "identify the part since the change"
    return NextStep(words, again(**{"from": f"{begin:.6g}"}))


def _column(situation: Situation) -> NextStep:
    found = re.search(COLUMN, situation.reason)
    name = "" if found is None else found[1]
    if time_candidates([name]):
        return _look(situation, "check how the output drifts, and whether the log holds several recordings")
    words = f"record with column {name} held still; or try it as the input"
    return NextStep(words, again("input", "reference", "delay", input=name))


def _swap(situation: Situation) -> NextStep:
    names = {"input": situation.log.output_name, "output": situation.log.input_name}
    return NextStep("exchange input and output", again(**names))


def _reference(situation: Situation) -> NextStep:
    if situation.poles > 1 and "unstable" in situation.reason:
        return _fewer(situation)
    if not (situation.is_searched or any(not time_candidates([name]) for name in situation.log.others)):
        return _search(situation)  # no column may be one: is the model wrong?
    return _look(situation, "give the set-point as --reference; check which column it is")


def _repeat(words: str, *without: str, **options: object) -> Callable[[Situation], NextStep]:
    """Return the step that repeats the command, without some options, and with others."""
    return lambda situation: NextStep(words, again(*without, **options))


_rows = partial(_look, words="check which of input and output a row records first; move the output down")
_move = partial(_look, words="move the input and record again; look at what it did in this record")
_rhythm = partial(
    _look, words="move the input in another rhythm and record again; check what else could move the output"
)
_sensor = partial(_look, words="look at the output: check the sensor, its range and its cable")
_straight = _repeat("let the input run in a straight line between its samples", input_hold="foh")
_at_rest = _repeat("if the plant began at rest, say so", x0=REST)
_default = _repeat("use the default method", "optimizer", "method", "startup")

#: Patterns of reasons, each with the next step; the first match counts.
STEPS: tuple[tuple[str, Callable[[Situation], NextStep]], ...] = (
    (r"are input and output swapped", _swap),
    (r"far from its others", _repeat("make these cells of the input empty, and repeat")),
    (
        r"held from report to report",
        _repeat("make the cells of the output empty that repeat the one before, and repeat"),
    ),
    (r"drifts along a straight line", lambda _: NextStep("remove the straight line", f"{again()} --detrend")),
    (COLUMN, _column),
    (FEWER, _fewer),
    (r"the input is constant|has rested|hardly moves|came to rest", _move),
    (r"does not move|has moved for|move together|could be left out|another model is as likely", _move),
    (r"does not excite every coefficient|is as fast as is looked for", _fewer),
    (r"the output (?:has only|is a copy)|explains almost nothing", _look),
    (r"s apart where dt says", _repeat("let the time stamps count", "dt")),
    (r"have a gap every", _without_stamps),
    (r"the (actuator|sensor) seems|acts otherwise|dry friction", _look),
    (r"run straight between|runs straight between", _straight),
    (r"before its row|where a controller opposes it|is recorded late", _rows),
    (r"than the model says", _dead_time),
    (r"has the input's period", _rhythm),
    (r"the initial state takes a part", _at_rest),
    (
        r"the reference (stands still|is a copy|explains nothing|follows|is not needed)|did not come to rest",
        _repeat("leave the reference out, or give the set-point", "reference"),
    ),
    (
        r"either its disturbances have more colour|only a reference|give its reference|answers to dist"
        r"|is a copy of the output|answers the residual of the same sample",
        _reference,
    ),
    (
        r"the plant seems to (?:have )?change|changes as the record goes on|its response differs|another load may act",
        _part,
    ),
    (r"another load acts since", _look),
    (r"to the bit|stuck|extreme of the output|no output has arrived|output is constant|left out", _sensor),
    (r"noise biases an estimate|left the range of float64|an update ", _default),
    (r"make it an input, too|explains nothing of the output|beside the others", _look),
    (r"the uncertainty of the model allows", _wait),
    (
        r"(?:inputs?|reference) could explain|leaves slow parts|filtered by its noise model|leave float64"
        r"|spoke against the model",
        _search,
    ),
    (r"residual (began to|had) grow|power of the residual|largest power|alone would put|residual is as usual", _part),
    (UNSURE, _fewer),
    (r"abs G is known to|is known to \S+ % only|varies slowly|rely on G", _fewer),
    (
        r"has moved by|coefficient that differs|too few|none is left|first model|no usable model|provisional"
        r"|estimate of",
        _wait,
    ),
    (
        r"answers the residual|is moved by the reference|is told apart|the model fits the output|may be chance"
        r"|the samples since",
        _keep,
    ),
)
