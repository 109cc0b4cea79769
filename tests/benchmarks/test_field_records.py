"""The campaign's field records: drawn as they say, simulated exactly, and counted as the table says."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from campaign import field
from campaign.anchor import anchor, poles_of, written
from campaign.exact import Clock, forced, free, poles_apart
from campaign.field_outcome import Estimate, FieldOutcome, delays, explained, features_of, response_explained
from campaign.field_table import FieldTable

DRAWN = [field.drawn(7, number) for number in range(60)]


def test_a_record_is_the_same_whenever_it_is_drawn() -> None:
    for one in DRAWN[:5]:
        again = field.drawn(7, one.number)
        assert again.plant == one.plant
        for name in ("u", "y", "clean", "all_t"):
            assert np.array_equal(getattr(again, name), getattr(one, name), equal_nan=True)
    assert field.drawn(8, 0).plant != DRAWN[0].plant


def test_records_are_within_what_is_said() -> None:
    for one in DRAWN:
        assert np.roots(one.plant.den).real.max() < 0.0
        assert one.u.size == one.y.size == one.clean.size == one.stamps.size <= field.SAMPLES[1]
        assert one.u.size >= (1.0 - one.lost) * field.SAMPLES[0] - 1
        assert np.isfinite(one.u).all()
        assert np.isnan(one.y).mean() <= field.MISSING[1] + 0.02  # of the rows that are not lost
        assert (one.t is None) == (one.jitter == 0.0 == one.lost)
        assert (np.diff(one.stamps) > 0.0).all()
        assert one.half == (one.plant.delay / one.dt % 1.0 > 0.1 and one.plant.delay / one.dt % 1.0 < 0.9)
        assert len(delays(one)) == 1 + one.half


def test_every_feature_is_drawn_and_can_be_seen() -> None:
    assert {one.input for one in DRAWN} == set(field.INPUTS)
    assert {one.noise for one in DRAWN} == set(field.NOISES)
    for name in ("bits", "missing", "jitter", "lost", "half"):
        assert {bool(getattr(one, name)) for one in DRAWN} == {False, True}
    for one in DRAWN:
        known = one.y[np.isfinite(one.y)]
        if one.bits:
            assert np.unique(known).size <= 2**one.bits + 1
        assert bool(np.isnan(one.y).any()) == bool(one.missing)
        if one.lost and not one.jitter:
            assert np.diff(one.stamps).max() > 1.9 * one.dt
        if one.jitter and not one.lost:
            assert np.abs(np.diff(one.stamps) / one.dt - 1.0).max() > 0.5 * one.jitter


def test_inputs_are_predictable() -> None:
    """Two past inputs tell the next one to a third of its size, the first family's white noise nothing of it."""
    for one in DRAWN:
        v = one.all_u[field.BEFORE :]
        x = np.column_stack([v[1:-1], v[:-2], np.ones(v.size - 2)])
        left = v[2:] - x @ np.linalg.lstsq(x, v[2:])[0]
        assert left.std() < 0.35 * v.std()


def test_the_response_is_that_of_a_held_input_on_any_clock() -> None:
    """Beside the package's own on a regular clock, and beside one of ten times the rate on an irregular one."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(200)
    for delay in (0.0, 0.3, 0.25):
        plant = rp.TransferFunction([2.0, -1.0], [1.0, 0.7, 4.0], delay)
        t = np.arange(200) * 0.1
        done = forced(poles_apart(np.roots(plant.den)), 1, Clock.of(t, u, delay, t)) @ plant.num
        assert done == pytest.approx(plant.simulate(u, 0.1), abs=1e-9)
        fine = np.sort(rng.choice(np.arange(1, 2000), 199, replace=False))
        fine = np.concatenate([[0], fine])
        held = u[np.searchsorted(fine, np.arange(2000), "right") - 1]
        done = forced(poles_apart(np.roots(plant.den)), 1, Clock.of(fine * 0.01, u, delay, fine * 0.01)) @ plant.num
        assert done == pytest.approx(plant.simulate(held, 0.01)[fine], abs=1e-9)


def test_poles_that_coincide_or_lie_at_the_origin_are_simulated() -> None:
    t, u = np.arange(50) * 0.1, np.ones(50)
    for poles, response in (([0.0], t), ([-1.0, -1.0], 1.0 - (1.0 + t) * np.exp(-t))):
        assert forced(poles_apart(poles), 0, Clock.of(t, u, 0.0, t))[:, 0] == pytest.approx(response, abs=1e-5)
    assert free(np.array([-1.0 + 2.0j, -1.0 - 2.0j]), t).shape == (50, 2)


def test_the_truth_explains_everything_and_another_plant_does_not() -> None:
    for one in DRAWN:
        assert explained(one, one.plant) == pytest.approx(100.0, abs=1e-3)
        assert response_explained(one, one.plant) == pytest.approx(100.0, abs=1e-3)
        twice = rp.TransferFunction(2.0 * one.plant.num, one.plant.den, one.plant.delay)
        assert response_explained(one, twice) == pytest.approx(0.0, abs=1e-3)
        assert explained(one, rp.TransferFunction(-one.plant.num, one.plant.den, one.plant.delay)) < 90.0


def test_logarithms_stand_for_the_poles_they_were_made_of() -> None:
    for one in DRAWN:
        poles = poles_of(written(one.plant.den, one.dt))
        assert np.poly(poles).real == pytest.approx(one.plant.den, rel=1e-9)


def test_the_anchor_fits_better_than_the_truth_and_is_kept(tmp_path: Path) -> None:
    one = next(one for one in DRAWN if one.structure.poles == 2 and one.noise == "white")
    kept = tmp_path / "anchors" / "one.json"
    found = anchor(one, [], kept)
    power = float(np.nanvar(one.y - one.clean))
    assert found.cost <= power
    assert explained(one, rp.TransferFunction(found.num, found.den, one.plant.delay)) > 90.0
    again = anchor(one, [("no better", 2.0 * one.plant.den)], kept)
    assert again.den == pytest.approx(found.den, rel=1e-12)
    other = anchor(replace(one, y=one.y + 1.0), [], kept)  # of another record nothing is kept
    assert other.cost == pytest.approx(found.cost, rel=1e-3)
    assert str(other.cost) != str(found.cost)


def test_the_table_counts() -> None:
    right = Estimate(99.0, 99.0, "trusted", "", 1.0, 0.1)
    poor, refused = replace(right, fit=80.0), replace(right, status="inconsistent")
    outcome = FieldOutcome(0, "", False, ("clock: regular",), 99.0, 2.0, right, right, right)
    table = FieldTable([
        replace(outcome, offline=replace(right, response=50.0)), replace(outcome, number=1, finished=poor),
        replace(outcome, number=2, offline=poor, finished=refused),
        replace(outcome, number=3, half=True, offline=replace(poor, status="converging")),
    ])  # fmt: skip
    lines = [line.measured.partition(" (")[0] for line in table.lines()]
    assert lines[:6] == ["1 of 3", "1 of 1", "1 of 3", "0 of 1", "0 of 3", "0 of 1"]
    assert lines[6:16] == ["2 of 3", "2 of 2", "1 of 3", "0 of 2", "1 of 1", "0 of 1", "-", "0 of 1", "-", "-"]
    assert lines[16:21] == ["2 of 3", "1 of 2", "1 of 3", "1 of 2", "1 of 2"]
    assert lines[21:26] == ["1 of 1", "1 of 1", "0 of 1", "0 of 1", "1 of 1"]
    assert "2: anchor 99.0" in " ".join(table.losing())
    assert math.isclose(table.by_feature().row_count, 1)


def test_features_name_each_kind_once() -> None:
    for one in DRAWN:
        kinds = [feature.partition(":")[0] for feature in features_of(one)]
        assert sorted(set(kinds)) == sorted(["input", "damping", "poles", "zeros", "sensor", "outputs", "clock", "rows",
                                             "noise"])  # fmt: skip
