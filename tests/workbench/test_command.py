"""The command line and the Python program that a card prints make its model again, to the bit."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import replant as rp
from replant.cli import main
from replant.workbench.choices import Setup, Stretch, Wish, command_line, program, words_of
from support.cases import every

CUT = Setup("u", "y", use=(Stretch(0.0, 60.0),), leave_out=(Stretch(10.0, 12.5),), validate_on=(Stretch(40.0),))
CASES = {
    "a fit": (Setup("u", "y"), Wish(poles="2", zeros="1")),
    "cut": (CUT, Wish(poles="1", delay="0.01")),
    "conditioned": (Setup("u", "y", time="t", detrend=True, decimate=2), Wish(poles="1")),
    "another clock": (Setup("u", "y", dt=0.02, resample=0.03), Wish(poles="1", delay="0.01")),
    "a search": (CUT, Wish("search", "1:2", delay="0:0.02:0.01")),
    "an online pass": (CUT, Wish("run", "1", delay="0.01")),
}


@pytest.fixture
def motor(tmp_path: Path) -> Path:
    """A log with another column, which the verdict may name."""
    log = rp.examples.motor()
    signals = zip(log.input.tolist(), log.output.tolist(), strict=True)
    text = "t,u,y,pump\n" + "".join(f"{0.02 * k:.2f},{u},{y},{k % 7}\n" for k, (u, y) in enumerate(signals))
    path = tmp_path / "motor 1.csv"
    path.write_text(text)
    return path


@pytest.mark.slow
@every("case", list(CASES))
def test_command_and_program_make_the_same_model(
    case: str, motor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    setup, wish = CASES[case]
    words = words_of(motor, setup, wish)
    typed, programmed = tmp_path / "typed.json", tmp_path / "programmed.json"
    main([*shlex.split(command_line(words, str(typed)))[1:], "--quiet", "--json"])
    source = program(motor, setup, wish, str(programmed))
    if case == "cut":  # from an interpreter of its own it is the same
        subprocess.run([sys.executable, "-c", source], check=True, capture_output=True)
    else:
        exec(compile(source, "printed", "exec"), {"__name__": "__main__"})
    assert rp.load_model(programmed) == rp.load_model(typed)
    assert rp.load_model(typed).provenance.sha256


def test_names_and_times_that_the_shell_would_read_otherwise() -> None:
    setup = Setup("-u; rm", "$(y)", reference="r'", leave_out=(Stretch(1e-7, 1234567.25),))
    words = words_of(Path("/logs/a b.csv"), setup, Wish(poles="1"))
    assert shlex.split(command_line(words)) == ["replant", *words, "--save", "model.json"]
    assert "0.0000001:1234567.25" in words
    compile(program(Path("/logs/a'\"b.csv"), setup, Wish(poles="1")), "printed", "exec")
