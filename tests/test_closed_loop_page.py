"""The example of docs/closed-loop.md runs, and shows what the page says of it."""

import re
import sys
from typing import Any

import numpy as np
import pytest

from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import closed_loop_pictures

from replant.assessment import control_loop

PAGE = closed_loop_pictures.PAGE.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """What the blocks of the page leave behind."""
    found: dict[str, Any] = {}
    for _ in closed_loop_pictures.run(closed_loop_pictures.blocks(PAGE), found):
        pass
    return found


def test_open_loop_methods_are_wrong_in_the_loop(names: dict[str, Any]) -> None:
    for estimate in (names["blind"].parameters, names["unwhitened"].parameters):
        assert np.abs(np.divide(estimate, names["TRUE"]) - 1.0).max() > 0.1


def test_the_default_is_right_with_and_without_the_reference(names: dict[str, Any]) -> None:
    for ident in (names["plain"], names["ident"]):
        assert (np.abs(ident.parameters - names["TRUE"]) < 3.5 * ident.uncertainty.std).all()
        assert (np.abs(ident.parameters - names["TRUE"]) < 0.1).all()


def test_only_the_model_with_the_reference_is_trusted(names: dict[str, Any]) -> None:
    verdict = names["ident"].assess()
    assert verdict.status == "trusted"
    assert control_loop.CLOSED in verdict.reasons
    refused = names["plain"].assess()
    assert refused.status == "inconsistent"
    assert any("reference" in reason for reason in refused.reasons)


def test_the_unstable_plant_is_trusted_with_the_reference_alone(names: dict[str, Any]) -> None:
    assert names["plain_2"].assess().status != "trusted"
    ident = names["ident_2"]
    assert ident.assess().status == "trusted"
    assert abs(-ident.parameters[0] - 1.0) < 3.5 * ident.uncertainty.std[0] < 0.2


def test_the_set_point_computed_from_the_controller_is_the_set_point(names: dict[str, Any]) -> None:
    again = names["set_point"](names["u"], names["y"], 2.0, 1.0, names["DT"])
    assert np.abs(again - names["r"]).max() < 1e-9


def test_the_noise_model_has_the_spectrum_of_load_and_sensor(names: dict[str, Any]) -> None:
    """Within a factor of two up to twice the plant's bandwidth: an autoregression of order four is not that noise."""
    omega = np.geomspace(0.1, 2.0, 30)
    ratio = names["ident"].noise.spectrum(omega) / closed_loop_pictures.true_spectrum(names, omega)
    assert ratio.min() > 0.5
    assert ratio.max() < 2.0


@pytest.mark.parametrize("words", [control_loop.CLOSED, control_loop.AT_ONCE, control_loop.COLOURED.partition(";")[0]])
def test_the_page_explains_the_words_of_the_verdict(words: str) -> None:
    assert f"| {words}" in PAGE


def test_every_output_of_the_page_is_there() -> None:
    assert not re.search(r"```text\n```", PAGE)


@pytest.mark.parametrize("picture", re.findall(r"\]\((pictures/[^)]*)\)", PAGE))
def test_every_picture_of_the_page_is_there(picture: str) -> None:
    assert (ROOT / "docs" / picture).is_file()
