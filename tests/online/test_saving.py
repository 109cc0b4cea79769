"""Saving to a file and going on from it: killed processes, damaged files, and what a user mistakes for a checkpoint."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.online import checkpoint_file as files
from replant.online import saving
from support.builders import identifier
from support.cases import every
from support.waiting import PATIENCE


def run(samples: int) -> rp.Identifier:
    ident = identifier()
    ident.update_many(np.arange(samples) % 3 - 1.0, np.arange(samples) % 5 - 2.0)
    return ident


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return saved_twice(tmp_path)


def saved_twice(folder: Path) -> Path:
    """Return a file saved after 10 samples, then after 20."""
    file = folder / "rig.checkpoint"
    for samples in (10, 20):
        run(samples).save(file, {"sequence": samples})
    return file


@pytest.mark.parametrize("kills", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_kills_leave_a_checkpoint_each(tmp_path: Path, kills: int) -> None:
    """At random moments, most of them in the middle of a saving; what goes on from there is right to the bit."""
    script = Path(__file__).parents[1] / "support" / "killed.py"
    done = subprocess.run(
        [sys.executable, script, tmp_path / "rig", str(kills), "1"], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["different"] == outcome["previous"] == 0
    assert outcome["samples"] >= 6 * kills  # each saved at least once
    assert outcome["during"] > 0


def test_saved_and_loaded(file: Path) -> None:
    loaded = saving.load(file)
    assert loaded.identifier.to_bytes() == run(20).to_bytes()
    assert loaded.progress == {"sequence": 20}
    assert loaded.used_previous is None
    assert saving.load(files.previous(file)).progress == {"sequence": 10}


def test_the_short_way(tmp_path: Path) -> None:
    file = tmp_path / "rig"
    run(7).save(file)
    assert rp.load(file).to_bytes() == rp.load(str(file)).to_bytes() == run(7).to_bytes()
    run(8).save(str(file), {"sequence": 8})
    assert saving.load(file).progress == {"sequence": 8}


@every("damage", [b"", b"t,u,y\n1,2,3\n", b"\x89replant", "cut", "flipped", "gone"], ids=str)
def test_a_damaged_file_is_refused_and_the_previous_one_is_used(tmp_path: Path, damage: bytes | str) -> None:
    file = saved_twice(tmp_path)
    data = file.read_bytes()
    if damage == "gone":
        file.unlink()
    elif damage == "cut":
        file.write_bytes(data[:-100])
    elif damage == "flipped":
        file.write_bytes(data[:500] + bytes([data[500] ^ 1]) + data[501:])
    else:
        file.write_bytes(bytes(damage))  # type: ignore[arg-type]
    loaded = saving.load(file)
    assert loaded.identifier.to_bytes() == run(10).to_bytes()
    assert loaded.progress == {"sequence": 10}
    assert loaded.used_previous is not None
    assert loaded.used_previous.startswith(f"{file}: ")
    assert "\n" not in loaded.used_previous
    with pytest.warns(UserWarning, match="the previous checkpoint is used instead") as caught:
        assert rp.load(file).samples == 10
    assert caught[0].filename == __file__


def test_nothing_is_said_where_nothing_is_wrong(file: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rp.load(file).samples == 20


def test_both_damaged(file: Path) -> None:
    file.write_bytes(b"")
    files.previous(file).write_bytes(b"x" * 100)
    with pytest.raises(rp.DamagedCheckpointError) as caught:
        saving.load(file)
    assert str(caught.value).startswith(f"{file}: it is empty; {file}.previous: it is not a checkpoint")


def test_none_there(tmp_path: Path) -> None:
    with pytest.raises(rp.MissingCheckpointError, match="no such file"):
        rp.load(tmp_path / "rig")
    with pytest.raises(FileNotFoundError):
        rp.load(tmp_path / "gone" / "rig")


def test_the_previous_one_is_found_through_a_link(file: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    link = tmp_path / "elsewhere" / "rig"
    link.symlink_to(file)
    file.write_bytes(b"")
    assert saving.load(link).identifier.samples == 10


@every("name", ["log.csv", "log.npz", "log.parquet", "log.mat", "model.json"])
def test_a_log_or_a_model_is_no_checkpoint_and_the_message_says_what_reads_it(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    if name == "log.npz":
        np.savez(file, t=np.arange(3.0), u=np.ones(3), y=np.ones(3))
    elif name == "model.json":
        rp.Model(rp.Structure(1), [1.0, 2.0], 0.1).save(file)
    else:
        file.write_bytes({"csv": b"t,u,y\n0,1,0\n0.1,1,0.5\n", "parquet": b"PAR1", "mat": b"MATLAB 5.0"}[name[4:]])
    with pytest.raises(rp.DamagedCheckpointError) as caught:
        rp.load(file)
    assert str(caught.value).startswith(f"{file}: it is not a checkpoint; ")
    assert ("`load_model` reads a model" if name == "model.json" else "read_log") in str(caught.value)


def test_other_mistakes(tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    with pytest.raises(rp.DamagedCheckpointError, match=r"empty: it is empty$"):
        rp.load(tmp_path / "empty")
    with pytest.raises(rp.CheckpointError, match="a directory; give the file inside it"):
        rp.load(tmp_path)
    (tmp_path / "circle").symlink_to("circle")
    for name in (str(tmp_path / "circle"), "a\0b", "x" * 300):
        with pytest.raises(rp.CheckpointError) as caught:
            rp.load(name)
        assert "\n" not in str(caught.value)


def test_a_saving_that_fails_leaves_identifier_and_file_alone(file: Path) -> None:
    ident = rp.Identifier(rp.Structure(1), 0.1, preprocess=rp.Preprocess(np.cbrt))
    with pytest.raises(rp.InvalidArgumentError, match="input_map"):
        ident.save(file)
    before = run(30).to_bytes()
    with pytest.raises(rp.CheckpointError, match="could not be written"):
        (working := run(30)).save(file.parent / "gone" / "rig")
    assert working.to_bytes() == before
    assert saving.load(file).progress == {"sequence": 20}
    assert {path.name for path in file.parent.iterdir()} == {file.name, f"{file.name}.previous"}


def test_every_error_is_replants_own() -> None:
    for kind in (rp.CheckpointError, rp.DamagedCheckpointError, rp.MissingCheckpointError):
        assert issubclass(kind, rp.ReplantError)
        assert issubclass(kind, rp.CheckpointError)
    assert str(rp.MissingCheckpointError("one line")) == "one line"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 22])
def test_what_has_ended_amid_an_alarm_is_saved_and_goes_on(seed: int, tmp_path: Path) -> None:
    """The end looks into the alarm, and what it finds plans the next look."""
    plant, rng = rp.TransferFunction([2.0], [1.0, 3.5, 3.5, 1.0]), np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], 60).repeat(40)[:2298]
    clean = plant.simulate(u, 0.05)
    loads = sum(size * (np.arange(u.size) >= begin) for begin, size in ((1359, -0.99), (1974, -0.96), (2041, -0.84)))
    y = clean + clean.std() * (loads + 0.15 * rng.standard_normal(u.size))
    y[303:453] = y[303]
    ident = rp.Identifier(rp.Structure(3), 0.05)
    ident.update_many(u, y)
    ident.finish()
    ident.save(tmp_path / "ended.json")
    again = rp.load(tmp_path / "ended.json")
    for each in (ident, again):
        each.update_many(u[:300], y[:300])
    assert np.array_equal(ident.parameters, again.parameters)


class Mine(rp.Identifier):
    """A user's own kind of identifier."""


class MineOfRows(type(rp.Identifier(poles=(1, 1), dt=0.1))):  # type: ignore[misc]
    """One of several inputs."""


def test_copies_and_checkpoints_of_a_subclass_are_of_the_subclass() -> None:
    ident = Mine(rp.Structure(1), dt=0.1)
    assert type(Mine.from_bytes(ident.to_bytes())) is Mine
    row = MineOfRows.of(rp.Identifier(poles=(1, 1), dt=0.1).request)
    for each in (ident, row):
        assert type(each.clone()) is type(copy.deepcopy(each)) is type(each)
