"""The campaign of random plants: what it draws is what it says, and its table counts what it says."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

import replant as rp
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from campaign import actuators, plants, reasons
from campaign.actuators import Trusted
from campaign.outcome import WORST, Outcome, explained, judged
from campaign.table import Campaign

DRAWN = [plants.drawn(7, number) for number in range(40)]


def test_plants_are_stable_and_within_what_is_said() -> None:
    for one in DRAWN:
        poles = np.roots(one.plant.den)
        sizes = np.abs(poles)
        assert poles.real.max() < 0.0
        assert sizes.max() <= 10.0**plants.DECADES * sizes.min() * 1.001
        assert plants.FASTEST[0] <= sizes.max() * one.dt <= plants.FASTEST[1] * 1.001
        assert plants.SAMPLES[0] <= one.u.size <= plants.SAMPLES[1]
        assert np.isfinite(one.y).all()
        assert one.u.std() > 0.0


def test_noise_has_the_power_that_is_said() -> None:
    for one in DRAWN:
        noise = one.y - one.clean
        if one.noise == "none":
            assert not noise.any()
        else:
            decibels = 20.0 * math.log10(one.clean.std() / noise.std())
            assert decibels == pytest.approx(one.decibels, abs=0.01)


def test_every_kind_is_drawn_and_another_seed_gives_others() -> None:
    assert {one.input for one in DRAWN} == set(plants.INPUTS)
    assert {one.noise for one in DRAWN} == set(plants.NOISES)
    assert {one.rests for one in DRAWN} == {False, True}
    assert plants.drawn(8, 0).plant != DRAWN[0].plant


def test_the_truth_explains_everything() -> None:
    for one in DRAWN[:5]:
        assert explained(one.plant, one.u, one.clean, one.dt) == pytest.approx(100.0)
        assert explained(one.plant, one.u, -one.clean, one.dt) == WORST


def test_a_record_is_judged() -> None:
    found = judged(next(one for one in DRAWN if one.structure.poles == 1 and one.noise == "white"))
    assert found.is_good
    assert not found.starting
    assert found.deviation < 6.0
    assert 0.0 < found.beside_bound < 6.0


@every("actuator", actuators.ACTUATORS.values(), ids=actuators.ACTUATORS)
def test_no_actuator_is_linear(actuator: object) -> None:
    u = np.sin(np.linspace(0.0, 20.0, 1000))
    out = actuator(u)  # type: ignore[operator]
    slope = float(u @ out / (u @ u))
    assert np.linalg.norm(out - slope * u) > 0.05 * np.linalg.norm(out)


def test_the_table_of_reasons_counts_each_of_good_and_of_bad_models() -> None:
    slow = "a coefficient has a standard deviation of {} %"
    found = reasons.table(
        {"online": [(slow.format(17), True), (slow.format("20.5"), False), ("no such reason, 3 s", True)], "`fit`": []}
    )
    columns = [list(column.cells) for column in found.columns]
    assert columns[0] == [slow.format("x"), "no such reason, x s"]
    assert columns[1:] == [["1, 1", "1, 0"], ["0, 0", "0, 0"]]


@pytest.mark.slow
def test_the_special_families_are_carried_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each family makes some model wrong; no more models are trusted than are wrong."""
    quick = {"asymmetric gain": actuators.ACTUATORS["asymmetric gain"]}  # alarms are few
    monkeypatch.setattr(actuators, "ACTUATORS", quick)
    behind, toggles, smooth = actuators.behind_actuators(7, 1), actuators.toggling(7, 2), actuators.smooth_inputs(7, 1)
    for found, most in ((behind, len(quick)), (toggles, 120), (smooth, 1)):
        assert 0 <= found.trusted <= found.wrong <= most
        assert found.wrong > 0
    assert 0 <= actuators.surplus_poles(7, 1) <= 1


def test_the_table_counts() -> None:
    right = Outcome(0, "", "white", False, 99.0, 99.0, False, "trusted", "", 1.0, False, 1.0)
    behind = replace(right, number=1, online=50.0, status="converging", deviation=4.0)
    silent = replace(right, number=2, online=WORST, starting=True, status="converging", deviation=math.nan)
    fooled = replace(right, number=3, online=50.0, offline=50.0)
    rests = replace(right, number=4, stilled=True, status="not excited")
    cancels = replace(right, number=5, status="not excited", deviation=0.0, unknown=True)
    none = Trusted(10, ())
    campaign = Campaign(
        [right, behind, silent, fooled, rests, cancels], none, Trusted(65, ("rig 1", "rig 2", "rig 3")), none, 1, 12
    )
    lines = {line.what: line for line in campaign.lines()}
    measured = [line.measured for line in lines.values()]
    assert measured == [
        "5, 3 of 6", "2 of 6", "1 of 6", "1 of 3", "1 of 3", "1 of 3", "1 of 5", "0 of 0", "0 of 0", "1 of 6", "1.00",
        "0 of 10", "3 of 65", "0 of 10", "1 of 12",
    ]  # fmt: skip
    assert [line.kept for line in lines.values()] == [
        None, False, False, False, False, False, False, True, True, None, None, True, False, True, False,
    ]  # fmt: skip
    worst = " ".join(campaign.worst())
    assert "1: online 50.0 %" in worst
    assert "3: trusted at 50.0 %" in worst
    assert "toggling: rig 1" in worst


@pytest.mark.parametrize("number", [53, pytest.param(110, marks=pytest.mark.slow)])
def test_a_chirp_that_shows_the_fast_modes_last_ends_where_the_record_does(number: int) -> None:
    """What the record gave when it was half as long is another plant; the recursion alone does not find back."""
    outcome = judged(plants.drawn(101, number))
    assert outcome.offline > 99.0
    assert outcome.online > outcome.offline - 1.0
    assert outcome.status == "trusted"


@pytest.mark.slow
def test_an_uncertain_model_takes_the_place_of_a_wrong_one() -> None:
    """Five poles at 7 dB: every right model is uncertain, and the first one, which explains nothing, is no less so."""
    experiment = plants.drawn(501, 137)
    ident, (u, y, dt) = rp.Identifier(experiment.structure, experiment.dt), (experiment.u, experiment.y, experiment.dt)
    of_all = (u, experiment.clean, dt)
    ident.update_many(u[:1000], y[:1000])
    assert explained(ident.transfer_function, *of_all) < 10.0
    ident.update_many(u[1000:6000], y[1000:6000])
    # the record is solved again each time that it has grown by half, last here at 4000 samples
    solved = rp.fit(u[:4000], y[:4000], dt, experiment.structure)
    assert explained(ident.transfer_function, *of_all) > explained(solved.transfer_function, *of_all) - 1.0 > 80.0


@pytest.mark.slow
def test_a_record_solved_as_a_whole_is_judged_as_a_whole() -> None:
    """An alarm ended where the input came to rest: what came since would not tell anything."""
    assert judged(plants.drawn(702, 942)).status == "trusted"
