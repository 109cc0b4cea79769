"""Types of options and words of the command line."""

from __future__ import annotations

import io
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from replant.cli import messages
from replant.cli.advice import _is_step_test
from replant.cli.conditioning_options import band_of, stretch_of, words_of
from replant.cli.fleet import _plain
from replant.cli.live import address_of, demo_of, looped, time_of
from replant.cli.messages import did_you_mean, is_given, to_ascii
from replant.cli.option_types import Choice, optimizer_of, real, whole_numbers
from replant.estimation.optimizers import OPTIMIZERS, AMSGrad
from support.cases import every

READ = [
    (band_of, "0.1:10", (0.1, 10.0)),
    (band_of, ":10Hz", (None, 10.0)),
    (stretch_of, "12s:1.5min", (12.0, 90.0)),
    (stretch_of, "60:", (60.0, None)),
    (time_of, "10min", 600.0),
    (real, "1e-3", 0.001),
    (whole_numbers, "1:4", ((1, 2, 3, 4),)),
    (whole_numbers, "2,1:2", ((2,), (1, 2))),
    (optimizer_of, "amsgrad:step_size=0.001", AMSGrad(step_size=0.001)),
    (optimizer_of, "AMSGrad", "amsgrad"),
    (Choice(["srivc", "least_squares"]), "least-squares", "least_squares"),
]
WORDS = [
    (words_of(0.1, 10.0), "0.1 to 10 Hz"),
    (words_of(0.1, None), "0.1 Hz and more"),
    (_plain("rig\n\x1b[31m7 é"), "rig??[31m7 é"),
    (looped("demo"), "demo?loop=pi"),
    (looped("demo?speed=max"), "demo?speed=max&loop=pi"),
    (demo_of("demo")[1].inputs, ("voltage [kV]",)),
    (demo_of("demo?loop=pi")[1].output, "speed [rad/s]"),
    (demo_of("log.csv"), None),
    (demo_of("demo.csv"), None),
    (address_of("--dashboard", "127.0.0.1:8710"), ("127.0.0.1", 8710)),
    (to_ascii("(1.2 ± 0.1)×10⁻⁷"), "(1.2 +- 0.1)x10^-7"),
    (to_ascii("Döner"), "D\\xf6ner"),
    (did_you_mean("amsgrd", ["adam", "amsgrad"]), "did you mean 'amsgrad'?"),
    (did_you_mean("magic", ["adam", "amsgrad"]), ""),
    (is_given("quiet"), False),
    (_is_step_test(np.array([0.0, 0.0, 1.0, 1.0])), True),
    (_is_step_test(np.array([0.0, 1.0, 0.0, 2.0, 2.0])), False),
]


@every("kind, typed, expected", READ)
def test_options_are_read(kind: Any, typed: str, expected: Any) -> None:
    assert kind(typed) == expected


@every("name", OPTIMIZERS)
def test_every_optimizer_is_chosen_by_its_name_and_by_its_settings(name: str) -> None:
    """A setting that is written as Python prints it is read to the bit."""
    suggested = OPTIMIZERS[name].suggested(0.01, 1000)
    assert optimizer_of(name) == name
    values = {key: value * 0.9 for key, value in vars(suggested).items() if value is not None}
    settings = ",".join(f"{key}={value!r}" for key, value in values.items())
    assert optimizer_of(f"{name}:{settings}") == OPTIMIZERS[name](**values)


@every("got, expected", WORDS)
def test_words(got: Any, expected: Any) -> None:
    assert got == expected


@every("width", [44, 60, 120])
@every("rate", [False, True])
def test_progress_takes_one_line(width: int, rate: bool) -> None:
    written = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.stderr, "isatty", lambda: True)
        patch.setattr(messages, "terminal", lambda **_: Console(file=written, width=width, force_terminal=True))
        bar = messages.progress_bar(rate=rate)
    bar.update(bar.add_task("identifying", total=1e6), completed=400_000)
    bar.tasks[0].finished_speed = 123_456.0
    lines = bar.console.render_lines(bar.get_renderable())
    assert len(lines) == 1
    assert ("samples/s" in "".join(segment.text for segment in lines[0])) == rate


INTERRUPTED = """
import sys
class Finder:
    def find_spec(self, name, *_):
        if name == "click":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Finder())
from replant.__main__ import main
main()
"""


def test_ctrl_c_while_libraries_are_imported_is_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "replant: interrupted\n")
