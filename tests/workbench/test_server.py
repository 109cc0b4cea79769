"""The workbench's server: access control, saved sessions, and answers to mistakes."""

from __future__ import annotations

import json
import stat
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest

from replant.errors import ReplantError
from replant.live.dashboard import security
from replant.workbench.app import opened
from replant.workbench.choices import Setup, Wish
from replant.workbench.model_cards import Card
from replant.workbench.session import Session, parsed, token
from support.cases import every
from support.http_request import ask
from support.waiting import PATIENCE, wait_until

EVERYTHING = (
    "GET /", "GET /assets/workbench.js", "GET /session", "GET /ask/signals?log=log1", "POST /do/fit",
    "POST /logs?name=a.csv", "GET /models/m1/model.json", "POST /models/m1/report",
)  # fmt: skip


@dataclass(frozen=True)
class Client:
    """The page as far as requests go."""

    port: int

    def send(self, method: str, path: str, body: bytes = b"") -> tuple[int, bytes]:
        headers = {"Origin": f"http://127.0.0.1:{self.port}", "Authorization": f"Bearer {token()}"}
        with closing(HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)) as wire:
            wire.request(method, path, body, headers)
            answer = wire.getresponse()
            return answer.status, answer.read()

    def do(self, name: str, **given: Any) -> tuple[int, bytes]:
        return self.send("POST", f"/do/{name}", json.dumps(given).encode())

    def ask(self, path: str) -> Any:
        status, body = self.send("GET", f"/ask/{path}")
        assert status == 200, body
        return json.loads(body)

    def session(self) -> dict[str, Any]:
        return json.loads(self.send("GET", "/session")[1])

    def is_read(self) -> None:
        wait_until(lambda: self.ask("signals?log=log1")["rows"], "the log is read")

    def card(self, *states: str) -> dict[str, Any]:
        """Wait until the newest card is in one of these states, and return it."""
        wait_until(lambda: self.session()["cards"][-1]["state"] in states, f"it is {states}")
        return self.session()["cards"][-1]


@contextmanager
def client(*logs: Path) -> Iterator[Client]:
    with opened(logs) as served:
        yield Client(served.port)


@pytest.fixture(autouse=True)
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have refusals come at once."""
    monkeypatch.setattr(security, "PAUSE", 0.0)


def test_nobody_gets_anything_without_token_host_and_origin(motor: Path) -> None:
    with opened([motor]) as served:
        good = f"Authorization: Bearer {token()}"
        for line in EVERYTHING:
            own = f"Origin: http://127.0.0.1:{served.port}"
            assert ask(served.port, line, own)[0] == 401, line
            assert ask(served.port, line, own, good, host="evil.example")[0] == 421, line
            if line.startswith("POST"):
                assert ask(served.port, line, good, "Origin: http://evil.example")[0] == 403, line
                assert ask(served.port, line, good)[0] == 403, line
        policy = ask(served.port, "GET /", good)[1]["content-security-policy"]
        assert "script-src 'self'" in policy
        assert "unsafe" not in policy


def test_the_token_is_the_users_own_and_stays(state: Path) -> None:
    word = token()
    assert token() == word
    assert len(word) >= 32
    assert stat.S_IMODE((state / "token").stat().st_mode) == 0o600
    assert stat.S_IMODE(state.stat().st_mode) == 0o700


def test_a_log_is_never_changed_and_a_dropped_one_is_found_again(motor: Path, state: Path) -> None:
    content = motor.read_bytes()
    before = motor.stat().st_mtime_ns
    Path("here.csv").write_bytes(content)
    with client() as page:
        assert page.send("POST", "/logs?name=..%2F..%2Fdropped.csv", content)[0] == 200
        assert page.send("POST", "/logs?name=here.csv", content)[0] == 200
        dropped, here = (Path(log["path"]) for log in page.session()["logs"])
    assert dropped.is_relative_to(state / "logs")
    assert dropped.name == "dropped.csv"
    assert dropped.read_bytes() == content
    assert here == Path.cwd() / "here.csv"
    assert (motor.read_bytes(), motor.stat().st_mtime_ns) == (content, before)
    assert [path for path in (state / "logs").iterdir() if path.name.startswith("drop-")] == []


TWO_HUNDRED = [[k, k + 1] for k in range(200)]
MISTAKES = [
    ("nosuch", {}, 404),
    ("fit", {"log": "log9"}, 409),
    ("fit", {"log": 3}, 409),
    ("fit", {"log": "log1", "wish": {"poles": "1:99"}}, 409),
    ("role", {"log": "log1", "column": "nope", "role": "input"}, 409),
    ("role", {"log": "log1", "column": "u", "role": "x"}, 409),
    ("show", {"card": "m9", "chosen": True}, 409),
    ("sort", {"order": "__class__"}, 409),
    ("rename", {"card": "m1", "title": "a" * 999}, 409),
    ("setup", {"log": "log1", "setup": []}, 409),
    *(
        ("setup", {"log": "log1", "setup": setup}, 409)
        for setup in (
            {"decimate": 1.5},
            {"resample": -1},
            {"leave_out": [[5, 3]]},
            {"use": "all"},
            {"use": TWO_HUNDRED},
        )
    ),
    *(
        ("wish", {"log": "log1", "wish": wish}, 409)
        for wish in ({"poles": "2; rm"}, {"poles": "9:1"}, {"kind": "demo"}, {"delay": "--out"}, {"zeros": "1e9"})
    ),
]


def test_mistakes_are_answered_in_one_line() -> None:
    log = Path("log.csv")
    log.write_text("t,u,y\n" + "".join(f"{k},{k % 3},{k % 5}\n" for k in range(99)))
    with client(log) as page:
        page.is_read()
        for name, given, expected in MISTAKES:
            status, body = page.do(name, **given)
            assert (status, body.count(b"\n")) == (expected, 1), (name, given, body)
            assert b"Traceback" not in body
        assert page.send("POST", "/do/fit", b"{")[0] == 409
        assert page.send("GET", "/ask/signals?log=log1&from=nan&to=1")[0] == 409
        assert page.session()["cards"] == []


def test_a_log_that_cannot_be_read_is_said_on_its_page(tmp_path: Path) -> None:
    path = tmp_path / "broken.csv"
    path.write_text("t,u,y\n0,1\n1,2,3,4\nx\n")
    session = Session(tmp_path / "broken.workbench", lambda view: None)
    try:
        log = session.open(path)
        wait_until(lambda: log.state == "broken", "it is said to be broken")
        assert "broken.csv" in log.error
        assert "\n" not in log.error
    finally:
        session.close()


@pytest.mark.slow
def test_a_session_is_saved_to_one_file_and_opened_again(motor: Path, tmp_path: Path) -> None:
    with client(motor) as page:
        page.is_read()
        page.do("role", log="log1", column="a", role="input")
        page.do("role", log="log1", column="b", role="output")
        page.do("setup", log="log1", setup={"validate_on": [[40.0, None]], "detrend": True})
        assert page.do("fit", log="log1", wish={"poles": "1", "delay": "0.01"})[0] == 200
        made = page.card("done")
        saved = tmp_path / "plant.workbench"
        saved.write_bytes(page.send("GET", "/session")[1])
    with client(saved) as page:
        page.is_read()
        kept = page.session()
        assert kept["cards"][0]["model"] == made["model"]
        assert kept["logs"][0]["setup"]["validate_on"] == [[40.0, None]]
        assert page.send("GET", "/models/m2/model.json")[1].decode() == made["model"]
        beside = page.ask("compared?log=log1&part=0")["models"]["m2"]
        assert beside["fit"] == pytest.approx(made["found"]["validations"][0]["fit"]["simulated"])
        unseen = made["found"]["validations"][0]["verdict"]["reasons"]
        assert [each["text"] for each in beside["verdict"]["reasons"]] == unseen
        over_all = page.ask("compared?log=log1&part=")["models"]["m2"]["verdict"]["reasons"]
        assert [each["text"] for each in over_all] == made["found"]["verdict"]["reasons"]  # it has seen them
        assert page.ask("responses")["models"]["m2"]["poles"]
        assert page.ask("conditioned?log=log1&points=50")["samples"] == 4093


@pytest.mark.slow
def test_the_report_of_a_card_is_a_page(motor: Path) -> None:
    with client(motor) as page:
        page.is_read()
        page.do("role", log="log1", column="a", role="input")
        page.do("role", log="log1", column="b", role="output")
        page.do("fit", log="log1", wish={"poles": "1", "delay": "0.01"})
        made = page.card("done")
        status, report = page.send("POST", f"/models/{made['name']}/report")
        assert status == 200
        assert b"<!doctype html>" in report[:40].lower()


WHOLE = {"replant_session": 1, "number": 1, "active": "", "order": "made", "shown": [], "logs": [], "cards": []}
DAMAGES = ["", "[]", "{}", '{"replant_session": 99}', '{"replant_session": 1, "logs": 3}', "\x00" * 9]
DAMAGES += [json.dumps(WHOLE | part) for part in ({"logs": [{"path": 3}]}, {"cards": [{}]}, {"number": "x"})]


@every("damage", DAMAGES)
def test_a_damaged_session_is_refused_in_one_line(damage: str) -> None:
    with pytest.raises(ReplantError) as told:
        parsed(damage, "plant.workbench")
    assert str(told.value).startswith("plant.workbench: ")
    assert "\n" not in str(told.value)


def test_a_session_says_what_to_fit_and_not_what_to_run(motor: Path) -> None:
    """The arguments of a command are made from columns and orders: a file cannot name another command or option."""
    with client(motor) as page:
        page.is_read()
        page.do("role", log="log1", column="b", role="output")
        page.do("role", log="log1", column="a", role="input")
        page.do("fit", log="log1", wish={"poles": "1"})
        kept = page.session()
    evil = {
        **kept["cards"][0],
        "words": ["live", "demo", "--record", "/tmp/evil"],
        "state": "stopped",
        "found": {},
        "model": "",
    }
    _, cards, _ = parsed(json.dumps({**kept, "cards": [evil]}), "evil")
    assert cards[0].words[:2] == ("fit", str(motor))


@pytest.mark.slow
def test_what_was_running_when_the_server_was_killed_can_be_fitted_again(motor: Path, state: Path) -> None:
    with client(motor) as page:
        page.is_read()
        page.do("role", log="log1", column="b", role="output")
        page.do("role", log="log1", column="a", role="input")
        page.do("fit", log="log1", wish={"kind": "search", "poles": "1:6", "delay": "0:0.4:0.01"})
    with client(motor) as page:
        assert [card["state"] for card in page.session()["cards"]] == ["stopped"]
        name = page.session()["cards"][0]["name"]
        assert page.do("repeat", card=name)[0] == 200
        assert page.do("stop", card=name)[0] == 200
        assert page.do("remove", card=name)[0] == 200
        assert page.session()["cards"] == []


@pytest.mark.slow
def test_a_record_that_goes_on_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "growing.csv"
    path.write_text("t,u,y\n" + "".join(f"{k / 10},{k // 7 % 2},{k % 11}\n" for k in range(300)))
    with client(path) as page:
        page.is_read()
        with path.open("a") as file:
            file.writelines(f"{k / 10},{k // 7 % 2},{k % 11}\n" for k in range(300, 500))
        page.do("read-again", log="log1")
        wait_until(lambda: page.ask("signals?log=log1")["rows"] == 500, "all rows are read")


def test_models_of_several_logs_are_told_apart_by_their_files(tmp_path: Path) -> None:
    session = Session(tmp_path / "s.workbench", lambda view: None)
    titles = []
    for number, file in enumerate(("a.csv", "a.csv", "b.csv"), 1):
        session.cards[f"m{number}"] = Card(f"m{number}", "1 pole", "log1", Path(file), Setup(), Wish(), ())
        titles.append([each["title"] for each in session.view()["cards"]])
    assert titles == [["1 pole"], ["1 pole"] * 2, ["1 pole, a.csv"] * 2 + ["1 pole, b.csv"]]
    assert {each["given"] for each in session.view()["cards"]} == {"1 pole"}
    session.close()
