"""``replant live`` over a pipe, sockets and a broker: to the bit what `Identifier.update_many` gives."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.cli import live as command
from replant.cli import main
from replant.cli.run_and_fit import fit_command
from replant.cli.run_fit_compare_options import structure_of
from replant.live.streams.demo import controlled
from replant.online import saving
from replant.rigs import deap_rig
from support.cases import every
from support.live_command import MODEL, ReplayingPeer, estimates, finished, learned, lines, live, sequence_of, wait_for
from support.live_fakes import DT, REQUEST, record
from support.places import ROOT

U, Y = record()

T = 5.0 + DT * np.arange(U.size)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


def test_a_pipe_ends_with_the_bits_of_run_on_what_was_recorded(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Without stamps: `replant run --startup` on the recorded folder is the very same identification."""
    data = b"".join(lines(U, Y))
    with live("-", "--to", "-", "--record", tmp_path / "record", "--checkpoint", tmp_path / "rig") as process:
        code, out, err = finished(process, data)
    assert code == 0
    assert "Traceback" not in err
    last = estimates(out)[-1]
    kept = saving.load(tmp_path / "rig").identifier
    assert kept.to_bytes() == learned(U, Y).to_bytes()
    assert [last["a0"], last["b0"]] == kept.parameters.tolist()
    assert (last["samples"], last["status"], last["trusted"], last["ttl"]) == (U.size, "ended", 0, 0.0)
    assert last["excited"] == 0
    assert last["verdict"] == "trusted"  # what was found in the end
    assert last["std_a0"] == pytest.approx(kept.uncertainty.std[0], rel=1e-9)
    assert "trusted" in err  # the summary: standard output is taken

    main(["run", str(tmp_path / "record"), "--input", "u", "--output", "y", *MODEL, "--json"])
    again = json.loads(capsys.readouterr().out)["parameters"]
    assert [again["a0"]["value"], again["b0"]["value"]] == kept.parameters.tolist()


@pytest.mark.slow
def test_a_second_process_solves_again_where_it_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    rig = tmp_path / "rig"
    with live("-", "--background", "--checkpoint", rig) as process:
        code, _, err = finished(process, b"".join(lines(U, Y)))
    assert (code, "Traceback" in err) == (0, False)
    kept, expected = saving.load(rig).identifier, rp.Identifier(**vars(REQUEST), background=True)
    expected.update_many(U, Y)
    assert kept.background
    assert kept.to_bytes() == expected.to_bytes()
    learned(U, Y).save(tmp_path / "without")
    with pytest.raises(SystemExit) as stop:
        main(["live", "-", *MODEL, "--background", "--checkpoint", str(tmp_path / "without")])
    assert stop.value.code == 2
    assert "was made without a second process" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["first", "last"])
def test_the_address_of_standard_input_is_no_option_wherever_it_stands(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[Any] = []

    def run(source: str, *_: Any, sinks: tuple[str, ...], **__: Any) -> bool:
        runs.append((source, list(sinks)))
        return True

    monkeypatch.setattr("replant.cli.live.run", run)
    source = "-?columns=n,t,y,u"
    main(["live", "--to", "-", *((source, *MODEL) if place == "first" else (*MODEL, source))])
    assert runs == [(source, ["-"])]


@pytest.mark.slow
def test_standard_input_may_have_options() -> None:
    with live("--to", "-", "-?columns=n,t,y,u", *MODEL, model=()) as process:
        code, out, err = finished(process, b"".join(lines(Y, U, T, first=0)))
    assert code == 0, err
    last = estimates(out)[-1]
    assert last["samples"] == U.size
    assert [last["a0"], last["b0"]] == learned(U, Y, T).parameters.tolist()


@every(
    ("arguments", "message"),
    [
        (["-?columns=n,q"], "-?columns=n,q: columns=n,q must name u and y"),
        (["-?colums=n,u,y"], "-?colums=n,u,y: unknown option 'colums'"),
        (["-q"], "No such option"),
        (["-", "--record"], "Option '--record' requires an argument"),
        ([], "Missing argument 'SOURCE'"),
        (["-?columns=u,y", "-?columns=u,y"], "Got unexpected extra argument"),
    ],
)
def test_what_is_wrong_with_an_address_of_standard_input_is_said(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["live", *MODEL, *arguments])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_the_loop_of_the_demo_is_recorded_with_its_reference(tmp_path: Path) -> None:
    folder = tmp_path / "record"
    options = ("--loop", "--dashboard", "off", "--samples", 1500, "--record", folder)
    with live("demo?speed=max", *options, model=()) as process:
        code, out, err = finished(process)
    assert (code, "Traceback" in err) == (0, False)
    assert "reference" in out
    log = rp.read_log(folder, input="u", output="y", reference="r")
    expected = next(controlled(0))
    for column, block in zip((log.input, log.output, log.reference), expected[1:], strict=True):
        np.testing.assert_array_equal(column, block[:1500])


def test_only_the_demo_has_a_loop(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["live", "log.csv", "--poles", "1", "--dt", "0.1", "--loop"])
    assert "--loop goes with the source demo, not with log.csv" in capsys.readouterr().err


@pytest.mark.slow
def test_the_demo_is_trusted_and_its_record_gives_the_bits_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """With the device's time stamps, as the page of documentation shows; on a regular clock within its rounding."""
    monkeypatch.chdir(tmp_path)
    options = ("--samples", 10_000, "--dashboard", "off", "--record", "DIR", "--checkpoint", "rig")
    with live("demo?speed=max", *options, model=()) as process:
        code, out, _ = finished(process)
    assert code == 0
    assert "● trusted" in out
    assert "off by" in out
    kept = saving.load(tmp_path / "rig").identifier
    rig = deap_rig().plant
    true = np.concatenate([rig.den[1:], rig.num])
    assert (np.abs(kept.parameters - true) < 4.0 * kept.uncertainty.std).all()

    page = (ROOT / "docs" / "live.md").read_text()
    code_shown = next(part for part in page.split("```python\n") if part.startswith("import pyarrow")).partition("```")
    names: dict[str, Any] = {}
    exec(code_shown[0], names)
    assert names["again"].to_bytes() == kept.to_bytes()

    model = ("--poles", "3", "--zeros", "1", "--input-map", "square", "--startup", "500")
    capsys.readouterr()
    main(["run", "DIR", "--input", "u", "--output", "y", *model, "--json"])
    found = json.loads(capsys.readouterr().out)["parameters"]
    np.testing.assert_allclose([found[name]["value"] for name in kept.names], kept.parameters, rtol=1e-6)


@pytest.mark.slow
def test_the_demo_takes_fewer_poles_than_its_rig_has(capsys: pytest.CaptureFixture[str]) -> None:
    """Its coefficients are then no estimates of the rig's, and do not stand beside them."""
    main(["live", "demo?speed=max", "--poles", "1", "--samples", "3000", "--dashboard", "off"])
    said = capsys.readouterr().out
    assert "b0" in said
    assert "off by" not in said
    main(["live", "demo?speed=max", "--samples", "3000", "--dashboard", "off"])
    assert "off by" in capsys.readouterr().out


@pytest.mark.slow
def test_a_summary_for_people_is_printed_in_the_end(tmp_path: Path) -> None:
    with live("-") as process:
        code, out, err = finished(process, b"nonsense\n1e999,2\n" + b"".join(lines(U, Y, T)))
    assert code == 0
    assert "G(s) = " in out
    assert "● trusted" in out
    assert "samples" in err  # a line of status: on a slow machine the only one comes before the first estimate
    assert "3,000 samples" in out
    assert "not a number" in out
    assert "Traceback" not in err


@pytest.mark.slow
def test_lines_over_tcp_with_stamps_and_numbers(tmp_path: Path) -> None:
    peer = ReplayingPeer(lines(U, Y, T, first=0))
    with live(peer.url, "--checkpoint", tmp_path / "rig", "--samples", U.size) as process:
        code, out, _ = finished(process)
    peer.close()
    assert code == 0
    assert "● trusted" in out
    loaded = saving.load(tmp_path / "rig")
    assert loaded.identifier.to_bytes() == learned(U, Y, T).to_bytes()
    assert loaded.progress["sequence"] == U.size - 1


@pytest.mark.slow
def test_lines_over_a_serial_port(tmp_path: Path) -> None:
    pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")
    tty = pytest.importorskip("tty", reason="this system has no pseudo-terminals")
    pytest.importorskip("serial", reason="pyserial is not installed")
    board, port = pty.openpty()
    tty.setraw(port)
    path = tmp_path / "rig"

    def send() -> None:
        rest = memoryview(b"half a li\n" + b"".join(lines(U, Y, T, first=0)))
        while rest:
            rest = rest[os.write(board, rest[:1024]) :]

    with live(f"serial://{os.ttyname(port)}", "--checkpoint", path, "--samples", U.size) as process:
        assert process.stderr is not None
        while b"samples" not in process.stderr.readline():  # until it listens
            assert process.poll() is None
        threading.Thread(target=send, daemon=True).start()
        code, out, _ = finished(process)
    os.close(port)
    os.close(board)
    assert code == 0
    assert "1 cut off" in out
    assert saving.load(path).identifier.to_bytes() == learned(U, Y, T).to_bytes()


@pytest.mark.slow
def test_datagrams_in_and_estimates_out(tmp_path: Path) -> None:
    """As a controller and PlotJuggler get them: a flat JSON object a datagram, numbers under their names."""
    port = free_port()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rig,
        live(
            f"udp://127.0.0.1:{port}?columns=n,t,u,y", "--samples", 1000, "--to",
            f"udp://127.0.0.1:{bound(controller)}", "--checkpoint", tmp_path / "rig", "--every", "1h",
        ) as process,
    ):  # fmt: skip
        controller.settimeout(0.2)  # then the lines are sent again
        rows = lines(U[:1000], Y[:1000], T[:1000], first=0)
        answers, at = [], 0

        def sent() -> bool:
            """Send the next lines; the number of the newest sample learned comes back: no datagram is lost for ever."""
            nonlocal at
            rig.sendto(b"".join(rows[at : at + 10]), ("127.0.0.1", port))
            with contextlib.suppress(TimeoutError):
                answers.append(json.loads(controller.recv(2000)))
                at = answers[-1]["sequence"] + 1
            return process.poll() is not None

        wait_for(sent, "the session had all samples")
        assert finished(process)[0] == 0
        answers += answers_left(controller)
    assert answers[-1]["sequence"] == 999
    assert answers[-1]["timestamp"] == T[999]
    identifier = learned(U[:1000], Y[:1000], T[:1000])
    assert [answers[-1]["a0"], answers[-1]["b0"]] == identifier.parameters.tolist()
    assert saving.load(tmp_path / "rig").identifier.to_bytes() == identifier.to_bytes()
    assert (answers[-1]["trusted"], answers[-1]["ttl"], answers[-1]["status"]) == (0, 0.0, "ended")
    numeric = {name for name, value in answers[-1].items() if not isinstance(value, str)}
    figures = {"schema_version", "timestamp", "sequence", "samples", "a0", "b0", "std_a0", "std_b0"}
    assert numeric == figures | {"trusted", "excited", "coefficients", "ttl", "sent"}


def answers_left(controller: socket.socket) -> list[dict[str, Any]]:
    """What has come and not been read."""
    controller.setblocking(False)
    found = []
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(json.loads(controller.recv(2000)))
    return found


def bound(receiver: socket.socket) -> int:
    receiver.bind(("127.0.0.1", 0))
    return int(receiver.getsockname()[1])


# --- MQTT


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    found = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if found is None:
        pytest.skip("no mosquitto: install it to test against a real broker")
    port = free_port()
    config = tmp_path / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    process = subprocess.Popen([found, "-c", str(config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for(lambda: answers(port))
        yield port
    finally:
        process.kill()
        process.wait()


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.slow
def test_samples_and_the_model_over_a_broker(broker: int, tmp_path: Path) -> None:
    """The model is retained: who subscribes later has it at once, with verdict and standard deviations."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    client = Client(CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", broker)
    client.loop_start()
    url = f"mqtt://127.0.0.1:{broker}"
    path = tmp_path / "rig"
    with live(
        f"{url}/rig/1", "--to", f"{url}/rig/1/model", "--samples", U.size, "--checkpoint", path, "--every", "100ms"
    ) as process:
        first = json.dumps({"n": 0, "t": T[0], "u": U[0], "y": Y[0]})

        def heard() -> bool:
            client.publish("rig/1", first, qos=1)
            return sequence_of(path) >= 0

        wait_for(heard)  # until it has subscribed, what is published is lost
        for at in range(1, U.size, 10):
            part = slice(at, at + 10)
            numbers = list(range(U.size))[part]
            batch = {"n": numbers, "t": T[part].tolist(), "u": U[part].tolist(), "y": Y[part].tolist()}
            client.publish("rig/1", json.dumps(batch), qos=1)
        code, _, _ = finished(process)
    assert code == 0
    assert saving.load(path).identifier.to_bytes() == learned(U, Y, T).to_bytes()

    retained: list[dict] = []
    client.on_message = lambda *arguments: retained.append(json.loads(arguments[2].payload))
    client.subscribe("rig/1/model", qos=1)
    # estimates have QoS 0: the broker may read this subscription before the session's last estimate
    model = wait_for(lambda: [each for each in retained if each["status"] == "ended" and "a0" in each])[0]
    client.disconnect()
    client.loop_stop()
    assert [model["a0"], model["b0"]] == learned(U, Y, T).parameters.tolist()
    assert model["trusted"] == 0
    assert model["std_a0"] > 0


# --- ends


def test_sigterm_leaves_a_checkpoint_and_a_summary(tmp_path: Path) -> None:
    path = tmp_path / "rig"
    peer = ReplayingPeer(lines(U, Y, T, first=0))
    with live(peer.url, "--checkpoint", path, "--every", "50ms") as process:
        wait_for(lambda: sequence_of(path) == U.size - 1)
        path.unlink()
        process.send_signal(signal.SIGTERM)
        code, out, err = finished(process)
    peer.close()
    assert code == 0
    assert "G(s) = " in out
    assert "Traceback" not in err
    assert saving.load(path).identifier.to_bytes() == learned(U, Y, T).to_bytes()


def killed_and_resumed(tmp_path: Path, times: int) -> None:
    """Kill it again and again while samples come, and let it go on from its checkpoint each time."""
    u, y = record(12_000)
    t = DT * np.arange(u.size)
    path = tmp_path / "rig"
    peer = ReplayingPeer(lines(u, y, t, first=0), block=20, pause=0.002)
    generator = np.random.default_rng(0)
    share = u.size // (times + 2)
    reached = [-1]
    for k in range(times):
        target = share * (k + 1)
        peer.until = target + share // 2  # however slow we are, it is killed before it has everything
        with live(peer.url, "--checkpoint", path, "--every", "20ms") as process:
            wait_for(lambda: sequence_of(path) >= target)  # noqa: B023 - called in this round only
            time.sleep(generator.uniform(0.0, 0.05))
            process.kill()
        reached.append(sequence_of(path))
        peer.resumed = True
    peer.until = u.size
    with live(peer.url, "--checkpoint", path, "--samples", u.size) as process:
        code, out, _ = finished(process)
    peer.close()
    assert code == 0
    assert f"{u.size:,} samples" in out
    assert all(np.diff(reached) > 0)
    assert saving.load(path).identifier.to_bytes() == learned(u, y, t).to_bytes()


@pytest.mark.slow
def test_killed_five_times_under_load_it_goes_on_to_the_bit(tmp_path: Path) -> None:
    killed_and_resumed(tmp_path, times=5)


# --- mistakes


@every(
    ("arguments", "message"),
    [
        (("-", "--dt", "0.1"), "--poles is missing"),
        (("-", "--poles", "1"), "--dt is missing"),
        (("nowhere.csv", "--poles", "1"), "nowhere.csv: no such file; check the path"),
        (("nowhere.csv?speed=1",), "nowhere.csv: no such file; check the path"),
        ((f"{__file__}?speed=1", "--poles", "1"), "--dt is missing"),
        (("ftp://x", *MODEL), "unknown scheme"),
        (
            ("tcp://127.0.0.1:9", *MODEL, "--for", "tomorrow"),
            "'tomorrow' is no length of time; write 60s, 10min or 24h",
        ),
        (("tcp://127.0.0.1:9", *MODEL, "--to", "http://x"), "give -, udp://HOST:PORT or mqtt://HOST:PORT/TOPIC"),
        (("tcp://127.0.0.1:9", *MODEL, "--to", "udp://127.0.0.1"), "give a port"),
        (("tcp://127.0.0.1:9", *MODEL, "--to", "udp://127.0.0.1:99999"), "give a port"),
        (("tcp://127.0.0.1:9", *MODEL, "--to", "mqtt://127.0.0.1"), "name one topic"),
        (
            ("tcp://127.0.0.1:9", *MODEL, "--to", "mqtt://me:secret@127.0.0.1:99999/a"),
            "--to mqtt://me@127.0.0.1:99999/a: give a port",
        ),
        (("tcp://127.0.0.1:9", *MODEL, "--dashboard", "here"), "write HOST:PORT"),
        (("tcp://127.0.0.1:9", *MODEL, "--checkpoint", "/nowhere/rig"), "there is no folder /nowhere; make it first"),
    ],
)
def test_a_mistake_is_one_line(arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["live", *arguments])
    out, err = capsys.readouterr()
    assert stop.value.code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert message in err


# --- the token


@every("way", ["environment", "file", "option", "option before environment", "file before environment"])
def test_the_token_comes_in_without_being_seen_in_the_list_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    tokens: list[Any] = []
    monkeypatch.setattr("replant.cli.live.run", lambda *_, dashboard, **__: tokens.append(dashboard.token) or True)
    monkeypatch.delenv("REPLANT_TOKEN", raising=False)
    path = tmp_path / "token"
    path.write_text("secret\nand more\n")
    if "environment" in way:
        monkeypatch.setenv("REPLANT_TOKEN", "secret" if way == "environment" else "other")
    options = {"file": ["--token-file", str(path)], "option": ["--token", "secret"]}.get(way.partition(" ")[0], [])
    main(["live", "-", *MODEL, "--dashboard", "127.0.0.1:8710", *options])
    assert tokens == ["secret"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--token", "a", "--token-file", "FILE"), "--token and --token-file: give one of them"),
        (("--token-file", "nowhere"), "--token-file nowhere: No such file or directory"),
        (("--token-file", "FILE"), "its first line is empty; write the token there"),
    ],
)
def test_a_token_that_cannot_be_had_is_one_line(
    tmp_path: Path, options: tuple[str, ...], message: str, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "token").write_text("\n")
    given = [str(tmp_path / "token") if option == "FILE" else option for option in options]
    with pytest.raises(SystemExit) as stop:
        main(["live", "-", *MODEL, *given])
    err = capsys.readouterr().err
    assert stop.value.code == 2
    assert err.count("\n") == 1
    assert message in err


@every(
    "words",
    [
        ("demo",), ("demo", "-p", "2", "--zeros", "0"), ("demo", "--loop"),
        ("-", "-p", "2", "--zeros", "1", "--delay", "0.30000000000001", "--dt", "1", "--bias", "--input-map", "square"),
        ("-", "-i", "Q1", "-i", "Q2", "-o", "T 1", "-p", "2,1", "--zeros", "1,0", "--delay", "0,8.5", "--dt", "1"),
    ],
)  # fmt: skip
def test_the_command_that_fits_the_record_has_the_options_of_the_session(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr(command, "run", lambda *all_, **more: given.update(more, request=all_[1]))
    with pytest.raises(SystemExit):
        main(["live", *words, "--dashboard", "off"])
    options = fit_command.make_context("fit", ["DIR", *given["to_fit"]]).params
    asked, inputs, signals = given["request"], options["input_column"], given["columns"]
    assert (inputs if isinstance(inputs, tuple) else (inputs,), options["output_column"]) == (
        signals.inputs, signals.output
    )  # fmt: skip
    if len(signals.inputs) == 1:
        options |= {name: options[name] or ((0,),) for name in ("zeros", "delay")}
        assert structure_of(options) == asked.structure
        assert options["input_map"] == asked.preprocess.input_map
    else:
        orders = zip(*(options[name] for name in ("poles", "zeros", "delay")), strict=True)
        assert list(orders) == [((one.poles,), (one.zeros,), (one.delay,)) for one in asked.structures]
    assert ("--reference" in given["to_fit"]) == ("--loop" in words)


@every(("source", "has"), [("-?columns=t,u,y,r", True), ("-?columns=t,u,y", False), ("log.csv?reference=w", True)])
def test_the_command_that_fits_the_record_has_the_reference_that_the_source_names(
    source: str, has: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Without it the estimate of a loop is biased."""
    given: dict[str, Any] = {}
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("t,u,y,w\n")
    monkeypatch.setattr(command, "run", lambda *_, **more: given.update(more))
    with pytest.raises(SystemExit):
        main(["live", source, *MODEL])
    assert given["to_fit"][-2:] == (["--reference", "r"] if has else ["--poles", given["to_fit"][-1]])


@every("named", [True, False])
def test_a_record_with_a_reference_that_a_header_named_is_to_be_fitted_with_it(
    named: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    u, y = record(300)
    rows = "".join(f"{a},{b},{k % 7}\n" for k, (a, b) in enumerate(zip(u, y, strict=True)))
    (tmp_path / "pipe").write_text(f"u,y,{'r' if named else 'room'}\n{rows}")
    with (tmp_path / "pipe").open() as pipe:
        done = subprocess.run(
            [sys.executable, "-m", "replant", "live", "-", *MODEL, "--record", str(tmp_path / "rec")],
            stdin=pipe, capture_output=True, text=True, check=True,
        )  # fmt: skip
    assert ("--reference r\n" in done.stderr) == named


@pytest.mark.slow
def test_a_dashboard_that_cannot_listen_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with live("-", "--dashboard", address) as process:
            code, out, err = finished(process, b"")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert f"cannot listen on {address}" in err
    assert err.endswith(f"choose another port, as in --dashboard 127.0.0.1:{int(address[10:]) + 1}, or off\n")


@pytest.mark.slow
def test_a_second_session_that_would_write_to_the_same_place_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    places = {"--record": tmp_path / "samples", "--checkpoint": tmp_path / "rig"}
    options = [word for place in places.items() for word in place]
    peer = ReplayingPeer(lines(U, Y, T, first=0))
    with live(peer.url, *options) as first:
        assert first.stderr is not None
        while b"look at the record while it grows" not in first.stderr.readline():  # until it holds both
            assert first.poll() is None
        for option, used in places.items():
            with pytest.raises(SystemExit) as stop:
                main(["live", "-", *MODEL, option, str(used)])
            out, err = capsys.readouterr()
            assert (stop.value.code, out) == (2, "")
            assert err == f"replant: {used}: another session writes there; end that one, or give another name\n"
        first.kill()
        first.wait()
    peer.close()
    with live("-", *options) as third:
        _, _, err = finished(third, b"")
    assert "another session" not in err


@every(
    ("rows", "message"),
    [
        ("t,u,y\n0,1,2\n0.1,2,3\n0.05,1,1\n0.3,1,2\n", "log.csv: line 4, column 't': the time stamp 0.05 goes back"),
        ("t,u,y\n0,1,2\n0.1,2,3\n0.2x,1,1\n0.3,1,2\n", "log.csv: line 4, column 't'"),
        ("t,volt,speed\n0,1,2\n0.1,2,3\n", "log.csv: no column 'u'; there are: t, volt, speed"),
        ("u,y\n1,2\n2,3\n", "log.csv: no column is called t, time or timestamp"),
    ],
)
def test_a_log_without_a_clock_says_why(
    rows: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "log.csv").write_text(rows)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(["live", "log.csv", "--poles", "1"])
    out, err = capsys.readouterr()
    assert (stop.value.code, out, err.count("\n")) == (2, "", 1)
    assert f"--dt is missing, and the log does not tell it: {message}" in err


def test_recording_into_a_used_folder_is_refused(tmp_path: Path) -> None:
    used = tmp_path / "samples"
    used.mkdir()
    (used / "part-00000001.parquet").write_bytes(b"")
    with live("-", "--record", tmp_path) as process:
        code, _, err = finished(process, b"")
    assert code == 2
    assert "already holds a record; choose another folder" in err
    assert err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("query", ["?input=u&output=y", "?dt=0.01"])
def test_a_log_tells_the_sampling_time(capfd: pytest.CaptureFixture, tmp_path: Path, query: str) -> None:
    log = tmp_path / "log.csv"
    log.write_text("t,u,y\n" + "".join(f"{0.01 * k:.2f},{u},{y}\n" for k, (u, y) in enumerate(zip(U, Y, strict=True))))
    said = []
    for more in ([], ["--dt", "0.01"]):
        main(["live", f"{log}{query}", "--poles", "1", "--to", "-", "--samples", "700", *more])
        captured = capfd.readouterr()
        said.append(json.loads(captured.out.splitlines()[-1]))
        assert ("note: --dt 0.01: the interval of" in captured.err) == (not more)
    assert said[0]["a0"] == said[1]["a0"]
