"""`inspect` on records with known truth, and on odd files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.fitting.log_inspection import beside_first_model, first_model, inspect, options_of
from replant.logs.column_roles import role_by_name
from replant.logs.columns import Column, Kind, describe
from replant.logs.read import read_log
from replant.model.transfer_function import TransferFunction
from replant.report.log_as_text import as_json, findings_of
from replant.signals import prbs, random_steps, white_noise
from support.cases import every

DT = 0.02
Signals = dict[str, np.ndarray]


def save(path: Path, signals: Signals) -> Path:
    table = np.column_stack(list(signals.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(signals), comments="", fmt="%.9g")
    return path


def open_loop(samples: int = 3000, *, delay: float = 0.0, noise: float = 0.0, seed: int = 1) -> Signals:
    """Return a record of 2/(0.3 s + 1) under random steps."""
    u = random_steps(samples, shortest=5, longest=60, low=-1.0, high=1.0, seed=seed)
    y = TransferFunction([2.0 / 0.3], [1.0, 1.0 / 0.3], delay=delay).simulate(u, dt=DT)
    y = y + noise * np.random.default_rng(seed).standard_normal(samples)
    return {"t": DT * np.arange(samples), "u": u, "y": y}


def closed_loop(samples: int = 3000, noise: float = 0.005) -> Signals:
    """Return a sampled record of the same plant under a PI controller whose set-point moves in steps."""
    rng = np.random.default_rng(3)
    r = np.repeat(rng.uniform(-1.0, 1.0, samples // 100), 100)
    a = np.exp(-DT / 0.3)
    y, measured, u, total = np.zeros(samples), np.zeros(samples), np.zeros(samples), 0.0
    for k in range(samples):
        if k:
            y[k] = a * y[k - 1] + 2.0 * (1.0 - a) * u[k - 1]
        measured[k] = y[k] + noise * rng.standard_normal()
        error = r[k] - measured[k]
        total += DT * error
        u[k] = 1.5 * error + 4.0 * total
    return {"a": DT * np.arange(samples), "b": r, "c": measured, "d": u}


@every("seed", range(4))
@every("noise", [0.0, 0.2])
@every("order", [("t", "u", "y"), ("t", "y", "u"), ("y", "u", "t")])
def test_without_telling_names_the_direction_is_that_of_the_plant(
    tmp_path: Path, order: tuple[str, ...], noise: float, seed: int
) -> None:
    signals = open_loop(noise=noise, seed=seed)
    path = save(tmp_path / "log.csv", {f"c{at}": signals[name] for at, name in enumerate(order)})
    found = inspect(path)
    assert found.clock is not None
    assert found.clock.column.number == order.index("t")
    assert found.clock.guess
    assert found.roles.input is not None
    assert found.roles.output is not None
    assert found.roles.input.column.number == order.index("u")
    assert found.roles.output.column.number == order.index("y")
    assert not found.roles.answers
    assert not found.roles.either


def test_a_prbs_is_an_input_whatever_its_name(tmp_path: Path) -> None:
    u = prbs(2000, hold=10)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.05)
    found = inspect(save(tmp_path / "log.csv", {"first": y, "second": u}))
    assert found.clock is None
    assert options_of(found) == ("-i", "second", "-o", "first", "-p", "2", "--dt", "S")


def test_names_decide_where_they_tell(tmp_path: Path) -> None:
    """Also against the signals: here input and output are exchanged on purpose."""
    signals = open_loop()
    path = save(tmp_path / "log.csv", {"t": signals["t"], "voltage": signals["y"], "speed": signals["u"]})
    found = inspect(path)
    assert options_of(found) == ("-i", "voltage", "-o", "speed", "-p", "2")
    assert found.roles.input is not None
    assert "follows" not in found.roles.input.why


@every(
    ("noise", "names"),
    [
        (0.05, ("t", "speed", "flow")),  # of a pump, whose speed moves in steps, and the flow follows it
        (0.1, ("t", "u", "T")),  # a temperature, which leaves no doubt about the time
    ],
)
def test_a_name_does_not_outweigh_what_the_samples_show(
    tmp_path: Path, noise: float, names: tuple[str, str, str]
) -> None:
    signals = dict(zip(names, open_loop(noise=noise).values(), strict=True))
    found = inspect(save(tmp_path / "log.csv", signals))
    assert (found.roles.input.column.name, found.roles.output.column.name) == names[1:]
    assert options_of(found) == ("-i", names[1], "-o", names[2], "-p", "2")


def test_a_column_that_is_given_is_taken(tmp_path: Path) -> None:
    path = save(tmp_path / "log.csv", open_loop())
    found = inspect(path, input="y")
    assert options_of(found)[:4] == ("-i", "y", "-o", "u")
    with pytest.raises(LogError, match="no column 'x'"):
        inspect(path, input="x")


def test_the_set_point_is_distinguished_from_the_input_and_a_controller_is_suspected(tmp_path: Path) -> None:
    found = inspect(save(tmp_path / "log.csv", closed_loop()))
    roles = found.roles
    assert roles.input is not None
    assert roles.output is not None
    assert roles.reference is not None
    assert [role.column.name for role in (roles.input, roles.output, roles.reference)] == ["d", "c", "b"]
    assert ("--reference", "b") in zip(options_of(found)[::2], options_of(found)[1::2], strict=True)


def test_without_its_set_point_the_controller_is_noticed(tmp_path: Path) -> None:
    signals = closed_loop(noise=0.5)
    found = inspect(save(tmp_path / "log.csv", {"t": signals["a"], "u": signals["d"], "y": signals["c"]}))
    assert found.response is not None
    assert found.roles.answers or found.response.peak == 0


@every("delay", [0.2, 0.5])
@every("noise", [0.0, 0.05])
def test_a_dead_time_is_seen_and_searched_for(tmp_path: Path, delay: float, noise: float) -> None:
    found = inspect(save(tmp_path / "log.csv", open_loop(delay=delay, noise=noise)))
    assert found.delay == pytest.approx(delay, abs=2 * DT)
    words = options_of(found)
    first, last, step = map(float, words[words.index("--delay") + 1].split(":"))
    assert first == 0.0
    assert first < delay < last
    assert 0.0 < step < delay


def test_no_dead_time_is_suggested_where_there_is_none(tmp_path: Path) -> None:
    u = random_steps(4000, shortest=20, longest=200, low=-1.0, high=1.0, seed=2)
    for den in ([1.0, 1.0], [1.0, 2.0, 1.0], [1.0, 0.4, 1.0]):
        y = TransferFunction([1.0], den).simulate(u, dt=0.05)
        found = inspect(save(tmp_path / "log.csv", {"t": 0.05 * np.arange(u.size), "u": u, "y": y}))
        assert found.response is not None
        assert "--delay" not in options_of(found)


def test_columns_are_described(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k},{0.25 * (k % 7)},5,,{'on' if k % 2 else 'off'},{'' if k == 3 else k % 3}" for k in range(50)]
    path.write_text("n,u,fixed,empty,state,y\n" + "\n".join(rows) + "\n")
    columns = {column.name: column for column in inspect(path).contents.columns}
    kinds = {name: column.kind for name, column in columns.items()}
    assert kinds == {
        "n": Kind.WHOLE, "u": Kind.REAL, "fixed": Kind.CONSTANT, "empty": Kind.EMPTY, "state": Kind.TEXT,
        "y": Kind.WHOLE,
    }  # fmt: skip
    u = columns["u"]
    assert (u.low, u.high, u.levels, u.step, u.quantised) == (0.0, 1.5, 7, 0.25, True)
    assert columns["y"].missing == 1
    assert columns["empty"].missing == 50
    assert "line 2" in columns["state"].problem


def test_a_damaged_cell_makes_its_column_text_and_names_the_place(tmp_path: Path) -> None:
    path = save(tmp_path / "log.csv", open_loop(100))
    lines = path.read_text().splitlines()
    lines[50] = lines[50].rpartition(",")[0] + ",oops"
    path.write_text("\n".join(lines) + "\n")
    found = inspect(path)
    assert found.contents.columns[2].problem.startswith("line 51, column 'y': 'oops' is not a number")
    assert found.roles.output is None
    assert options_of(found) == ()


def test_columns_of_text_with_one_name_leave_the_others_readable(tmp_path: Path) -> None:
    """X-Plane writes a column of bars between two columns: all bars have the same line and name in the error."""
    path = tmp_path / "log.csv"
    path.write_text("u,|,y,|\n" + "".join(f"{k % 7},|,{k % 5},|\n" for k in range(30)))
    assert [column.name for column in inspect(path).contents.columns if column.is_signal] == ["u", "y"]


@every(
    ("text", "message"),
    [
        ("", "empty"),
        ("t,u,y\n", "only a header"),
        ("name\nanna\nbert\n", "'anna' is not a number|'name' is a name|not a number"),
        ("t,u,y\n0,1,2\n1,2\n2,1,2\n", "line 3 has 2 cells"),
    ],
)
def test_a_file_without_numbers_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=message):
        inspect(path)


@every(
    "text",
    [
        "u\n1\n2\n1\n",
        "t,u,y\n0,1,2\n1,2,3\n",
        "u,y\n1,1\n1,1\n1,1\n",
        "u,y\n1,1e308\n2,-1e308\n1,5\n",
        "t,u\n,\n,\n,\n",
    ],
    ids=["one column", "two rows", "constant", "huge", "empty cells"],
)
def test_odd_files_are_described_without_a_warning(tmp_path: Path, text: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    assert inspect(path).contents.columns


@every(
    ("name", "scale", "unit"),
    [
        ("t_ms", 1e3, 1e-3),
        ("time [us]", 1e6, 1e-6),
        ("timestamp_ns", 1e9, 1e-9),
        ("t", 1.0, 1.0),
        ("Time (msec)", 1e3, 1e-3),
    ],
)
def test_a_unit_in_the_name_needs_no_guess(tmp_path: Path, name: str, scale: float, unit: float) -> None:
    signals = open_loop(500)
    signals = {name: scale * signals.pop("t"), **signals}
    clock = inspect(save(tmp_path / "log.csv", signals)).clock
    assert clock is not None
    assert (clock.unit, clock.doubt, clock.guess) == (unit, "", "")
    assert clock.dt == pytest.approx(DT)


def test_counts_without_a_unit_are_doubted(tmp_path: Path) -> None:
    signals = open_loop(500)
    path = save(tmp_path / "log.csv", signals | {"t": 1e3 * signals["t"]})
    found = inspect(path)
    assert found.clock is not None
    assert "may be milliseconds" in found.clock.doubt
    assert found.clock.dt == pytest.approx(20.0)
    assert "--dt" not in options_of(found)


def test_milliseconds_since_1970_are_recognised_by_their_size(tmp_path: Path) -> None:
    signals = open_loop(500)
    for begin, is_read in ((1.7e12, True), (1.7e13, False)):  # of the year 2508 it may be a count of another unit
        stamps = np.rint(begin + 1e3 * signals["t"])
        np.savez(tmp_path / "log.npz", timestamp=stamps, u=signals["u"], y=signals["y"])
        found = inspect(tmp_path / "log.npz")
        assert found.clock is not None
        assert "milliseconds since 1970" in found.clock.doubt
        assert found.clock.dt == pytest.approx(0.02)
        assert ("--dt" not in options_of(found)) == is_read
    assert options_of(found)[-2:] == ("--dt", "0.02")


@pytest.mark.slow
def test_values_that_stand_for_missing_ones_are_left_out_of_the_response_as_of_a_fit(tmp_path: Path) -> None:
    """In one piece, as of a sensor that was off, and one by one; records without them show nothing of the kind."""
    rng, near, said = np.random.default_rng(41), 0, 0
    for number in range(6):
        signals = open_loop(1500, noise=0.01, seed=number)
        assert not inspect(save(tmp_path / "clean.csv", signals)).doubted
        y = signals["y"].copy()
        y[slice(600, 901) if number % 2 else rng.choice(y.size, 30, replace=False)] = -9999.0
        found = inspect(save(tmp_path / "log.csv", {**signals, "y": y}))
        is_same_row = found.response is not None and found.response.peak == 0
        near += found.delay is not None and found.delay < 2.0 * DT and not is_same_row  # it has no dead time
        said += "left out of it, as of a fit" in "".join(text for _, text in findings_of(found))
    # of 30 single values, more than half may happen to be at steps of the input
    assert near >= 5
    assert said >= 5


def check_clock(path: Path, column: str | None, u: str = "u", y: str = "y") -> None:
    """Check that the inspection has the clock of a fit, without a guess or a doubt."""
    found, log = inspect(path), read_log(path, input=u, output=y)
    assert found.clock is not None
    assert (None if found.clock.column is None else found.clock.column.name) == column
    assert (found.clock.guess, found.clock.problem) == ("", "")
    assert found.clock.dt == pytest.approx(log.dt) == DT
    assert options_of(found) == ("-i", u, "-o", y, "-p", "2")
    name = column or "Ts, a number in the file"
    assert dict(findings_of(found))["Clock"] == f"{name}: dt 20 ms, 59.98 s, regular"
    assert as_json(found)["clock"]["column"] == column


def test_a_column_of_dates_is_the_clock_whatever_its_name(tmp_path: Path) -> None:
    signals, path = open_loop(), tmp_path / "log.csv"
    rows = enumerate(zip(signals["u"], signals["y"], strict=True))
    lines = [f"2024-05-01 10:00:{row / 50:06.3f},{u:.9g},{y:.9g}\n" for row, (u, y) in rows]
    path.write_text("date,u,y\n" + "".join(lines), encoding="utf-8")
    check_clock(path, "date")


def test_a_second_clock_is_no_input_or_output(tmp_path: Path) -> None:
    """The log has milliseconds and a counter of rows in addition to the time."""
    signals = open_loop(noise=0.01)
    rows = np.arange(signals["u"].size)
    clocks = {"epoch": 1e6 + 20.0 * rows, "row": 3.0 + rows}
    found = inspect(save(tmp_path / "log.csv", {"t": DT * rows, **clocks, "u": signals["u"], "y": signals["y"]}))
    assert found.roles.input.column.name == "u"
    assert found.roles.output.column.name == "y"
    assert not found.others
    alone = inspect(save(tmp_path / "alone.csv", {"t": DT * rows, "u": signals["u"], "way": 3.0 + rows}))
    assert alone.roles.output.column.name == "way"  # nothing else is left


@every("clock", ["elapsed", "milliseconds since 1970", "with pauses"])
def test_a_column_that_counts_the_rows_is_no_clock_beside_one(tmp_path: Path, clock: str) -> None:
    signals = open_loop()
    t = signals.pop("t")
    if clock != "elapsed":
        t = np.rint(1.7e12 + 1e3 * t) + (1e5 * (np.arange(t.size) // 20) if clock == "with pauses" else 0.0)
    path = tmp_path / "log.csv"
    columns = {"No": np.arange(t.size), "stamp": t, **signals}
    rows = np.column_stack(list(columns.values())).tolist()
    path.write_text(",".join(columns) + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    found = inspect(path)
    assert found.clock is not None
    assert found.clock.column.name == "stamp"
    assert found.clock.dt == pytest.approx(DT)


def test_a_column_that_counts_the_rows_is_no_clock(tmp_path: Path) -> None:
    signals = open_loop()
    found = inspect(save(tmp_path / "log.csv", {**signals, "t": np.arange(1.0, 3001.0)}))
    assert found.clock.column.name == "t"  # by its name
    del signals["t"]
    found = inspect(save(tmp_path / "log.csv", {"row": np.arange(3000), **signals}))
    assert found.clock is None
    assert options_of(found) == ("-i", "u", "-o", "y", "-p", "2", "--dt", "S")
    assert "'row' counts the rows" in dict(findings_of(found))["Clock"]


@every("sparse", ["u", "y"])
def test_cells_that_are_written_at_changes_are_held(tmp_path: Path, sparse: str) -> None:
    """No controller is seen in them."""
    signals = open_loop(noise=0.05)
    empty = np.diff(signals[sparse], prepend=np.nan) == 0.0 if sparse == "u" else np.arange(3000) % 5 > 0
    signals[sparse] = np.where(empty, np.nan, signals[sparse])
    found = inspect(save(tmp_path / "log.csv", signals))
    assert options_of(found)[:4] == ("-i", "u", "-o", "y")
    assert not found.roles.answers


def test_rows_of_their_own_with_one_stamp_are_one_row(tmp_path: Path) -> None:
    """If every second row of a stamp were dropped, all outputs would be lost."""
    signals = open_loop(noise=0.05)
    path = tmp_path / "log.csv"
    rows = zip(*(each.tolist() for each in signals.values()), strict=True)
    path.write_text("t,u,y\n" + "".join(f"{t},{u},\n{t},,{y}\n" for t, u, y in rows))
    found = inspect(path)
    assert found.clock is not None
    assert (found.clock.dt, found.clock.problem, found.rows) == (DT, "", 3000)
    assert options_of(found) == ("-i", "u", "-o", "y", "-p", "2")


def test_a_number_called_ts_is_the_clock(tmp_path: Path) -> None:
    signals, path = open_loop(), tmp_path / "log.npz"
    np.savez(path, u=signals["u"], y=signals["y"], Ts=DT)
    check_clock(path, None)


def test_a_time_in_a_group_of_an_hdf5_file_is_the_clock(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    signals, path = open_loop(), tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        for name, signal in signals.items():
            file[f"rig/{name}"] = signal
        file["rig/time"] = file["rig/t"][()]
        del file["rig/t"]
    check_clock(path, "rig/time", "rig/u", "rig/y")


def test_jitter_and_gaps_are_measured(tmp_path: Path) -> None:
    signals = open_loop(1000)
    rng = np.random.default_rng(5)
    stamps = signals["t"] + 0.05 * DT * rng.standard_normal(1000)
    stamps[500:] += 1.0
    found = inspect(save(tmp_path / "log.csv", signals | {"t": stamps}))
    assert found.clock is not None
    assert found.clock.jitter == pytest.approx(2**0.5 * 0.05 * DT, rel=0.15)
    assert (found.clock.gaps, found.clock.backward) == (1, 0)
    assert found.clock.longest == pytest.approx(1.0 + DT, abs=0.3 * DT)


def test_a_missing_stamp_counts_once_and_a_repeated_row_is_noted(tmp_path: Path) -> None:
    signals = open_loop(1000)
    found = inspect(save(tmp_path / "lost.csv", signals | {"t": np.where(np.arange(1000) == 7, np.nan, signals["t"])}))
    assert found.clock is not None
    assert (found.clock.backward, found.clock.gaps, found.table.notes) == (1, 0, ())
    rows = np.insert(np.arange(1000), 500, [499, 499])
    found = inspect(save(tmp_path / "twice.csv", {name: signal[rows] for name, signal in signals.items()}))
    (note,) = found.table.notes
    assert "2 rows repeat the previous one, with the same time stamp; repetitions are left out" in note
    assert found.rows == 1000


@pytest.mark.parametrize("rows", [2, 4, 7, 10])
def test_stamps_too_coarse_for_their_rows_are_counted(tmp_path: Path, rows: int) -> None:
    """Stamps in whole seconds, several rows each: with rows one second apart, a time constant would be too long."""
    signals = open_loop(1000)
    found = inspect(save(tmp_path / "log.csv", signals | {"t": np.floor(np.arange(1000) / rows)}))
    assert found.clock is not None
    assert found.clock.dt == pytest.approx(1.0 / rows)
    assert options_of(found)[-2] == "--dt"
    assert float(options_of(found)[-1]) == pytest.approx(1.0 / rows, rel=1e-5)


def test_a_long_log_is_looked_at_from_its_beginning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replant.logs.columns.MOST_ROWS", 800)
    found = inspect(save(tmp_path / "log.csv", open_loop(2000)))
    assert (found.rows, found.contents.whole) == (800, False)


REAL = {
    "un_dcmotor/DCmotor_prbs_open_exp.csv": ("u", "y", None),
    "un_dcmotor/DCmotor_step_open_exp.csv": ("u", "y", None),
    "un_dcmotor/DCmotor_stairs_closed_exp.csv": ("u", "y", "r"),
    "un_dcmotor/DCmotor_profile_closed_exp.csv": ("u", "y", "r"),
    "un_thermal/Thermal_prbs_open_exp.csv": ("u", "y", None),
    "un_thermal/Thermal_step_closed_exp.csv": ("u", "y", "r"),
    "ayala_ballhoop/randomStepSequence.mat": ("u", "y", None),
    "ayala_ballhoop/closedLoop.mat": ("u", "y", "yref"),
    "exchanger/exchanger_dat.mat": ("exchanger_dat[:,1]", "exchanger_dat[:,2]", None),
    "tclab/tclab_kuntz_rawlings_2022.mat": ("data.udat[:,0]", "data.ydat[:,0]", None),
}


@every("name", REAL, quick=1)
def test_real_logs(datasets: Path, name: str) -> None:
    roles = inspect(datasets / name).roles
    if roles.reference is None:  # all of these are open loops
        assert not roles.answers
    chosen = [role and role.column.name for role in (roles.input, roles.output, roles.reference)]
    assert tuple(chosen) == REAL[name]


@every("name", [name for name in REAL if "open" in name or "random" in name])
def test_real_logs_without_their_names(datasets: Path, tmp_path: Path, name: str) -> None:
    found = inspect(datasets / name)
    assert found.clock is not None
    columns: dict[str, np.ndarray] = {
        f"c{column.number}": found.contents.values[column.number] for column in found.record
    }
    np.savez(tmp_path / "log.npz", **columns)
    blind = inspect(tmp_path / "log.npz")
    assert blind.clock is not None
    assert blind.clock.column.number == found.clock.column.number
    assert blind.roles.input is not None
    assert found.roles.input is not None
    assert blind.roles.input.column.number == found.roles.input.column.number


@pytest.mark.slow
def test_the_intervals_of_a_clock_that_jitters_are_no_gaps(tmp_path: Path) -> None:
    t = np.cumsum(np.random.default_rng(1).exponential(0.5, 800) + 0.5)
    t[400:] += 60.0
    signals = {"t": t, "u": np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 80), 10), "y": np.sin(t)}
    clock = inspect(save(tmp_path / "log.csv", signals)).clock
    assert clock is not None
    assert 1 <= clock.gaps < 16  # an interval in 400 is that long by chance
    assert clock.longest > 60.0


def test_a_name_tells_the_role_by_its_words() -> None:
    names = ("u1", "motor_speed [rpm]", "data.ydat[:,0]", "set-point", "yref", "extra")
    assert [role_by_name(name) for name in names] == ["input", "output", "output", "reference", "reference", None]


def test_a_step_without_significant_correlation_gets_a_first_model() -> None:
    u = np.where(np.arange(200) < 20, 0.0, 1.0)
    y = TransferFunction([0.5], [2.0, 1.0], 3.0).simulate(u, 0.5)
    found = first_model(u, y + 0.01 * np.random.default_rng(1).standard_normal(200), 0.5)
    assert found is not None
    assert (round(found.delay), round(found.time_constant)) == (3, 2)


def test_a_column_that_moves_the_output_in_steps_is_named() -> None:
    """Without its column, it would be a load that the fit removes from the output."""
    k = np.arange(2000)
    u, d = prbs(k.size, hold=16), np.where((k > 700) & (k < 1500), 1.0, 0.0)
    y = TransferFunction([0.5], [2.0, 1.0]).simulate(u, 0.1) + 3.0 * d + white_noise(k.size, 0.05)
    found = beside_first_model(u, y, 0.1, 0.0, {"d": d, "noise": white_noise(k.size, 1.0)})
    assert [other.name for other in found] == ["d"]


def test_where_neither_column_answers_either_may_be_the_input_unless_it_is_given(tmp_path: Path) -> None:
    a, b = np.random.default_rng(0).standard_normal((2, 600))
    path = save(tmp_path / "log.csv", {"t": DT * np.arange(600), "a": a, "b": b})
    assert inspect(path).roles.either
    assert not inspect(path, input="a").roles.either


def test_a_column_without_numbers_is_neither_quantised_nor_held() -> None:
    """Nothing is known of the column, so it gets no role."""
    for column in (describe(0, "x", np.full(5, np.nan)), Column(1, "name", Kind.TEXT, 5, 5)):
        assert (column.levels, column.quantised, column.held, column.is_signal) == (0, False, 0.0, False)


@every("names", [("Zeit", "u", "T"), ("u", "T")])
def test_a_temperature_under_the_letter_t_is_the_output_of_a_log(tmp_path: Path, names: tuple[str, ...]) -> None:
    signals = dict(zip(("Zeit", "u", "T"), open_loop(noise=0.1).values(), strict=True))
    found = inspect(save(tmp_path / "log.csv", {name: signals[name] for name in names}))
    assert found.roles.output is not None
    assert found.roles.output.column.name == "T"
    assert (found.clock is None) == ("Zeit" not in names)
