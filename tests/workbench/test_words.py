"""The user's choices as text: command lines, titles, stretches of time, and the plots that show reasons."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from replant.workbench.app import _safe
from replant.workbench.choices import Setup, Stretch, Wish, command_line, numbers, plain, words_of
from replant.workbench.drawn_samples import Doubt, doubts
from replant.workbench.model_cards import Place, in_order, place_of, title_of
from support.cases import every

LEFT_OUT = Setup("u", "y", leave_out=(Stretch(10.0, 12.0),))
COMMAND = ("/logs/motor.csv", "-i", "u", "-o", "y", "-p", "2", "--leave-out", "10:12")


@every(
    ("found", "expected"),
    [
        (Stretch(12.5, 40.0).written, "12.5:40"),
        (Stretch(1e-7).written, "0.0000001:"),
        (plain(40.0), "40"),
        (plain(0.05), "0.05"),
        (plain(1234567.5), "1234567.5"),
        ([each.poles for each in Wish(poles="1:3").alone], ["1", "2", "3"]),
        (len(Wish("search", poles="1:3").alone), 1),
        (numbers("1:3"), ["1", "2", "3"]),
        (numbers("0:0.1:0.05"), ["0", "0.05", "0.1"]),
        (numbers("0.02"), ["0.02"]),
        (words_of(Path("/logs/motor.csv"), LEFT_OUT, Wish(poles="2"))[1:], COMMAND),
        (command_line(("fit", "my log.csv", "-p", "1")), "replant fit 'my log.csv' -p 1 --save model.json"),
        (title_of(Wish(poles="2", zeros="1", delay="0.01")), "2 poles, 1 zero, 0.01 s"),
        (title_of(Wish("search", "1:4")), "best of 1:4 poles"),
        (in_order([], "fit"), []),
        (_safe("../../motor.csv"), "motor.csv"),
        (place_of("the residual began to grow 12.5 s ago: the plant has changed"), Place("residual", 12.5)),
        (
            place_of("a zero may cancel the pole near -3.2 rad/s, so that the coefficients are not known"),
            Place("poles", None, 3.2),
        ),
        (place_of("the input could explain another 12 % of the output's power over the last 40 s").plot, "cross"),
    ],
)
def test_commands_titles_and_texts_are_as_expected(found: object, expected: object) -> None:
    assert found == expected


def test_a_stuck_sensor_is_listed_as_doubtful() -> None:
    t = np.arange(400.0)
    y = np.where((t >= 100) & (t < 160), 5.0, np.sin(t))
    assert doubts(t, np.cos(t), y) == [Doubt(100.0, 160.0, "the output stays at 5 while the input moves")]
