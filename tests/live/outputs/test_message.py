"""The message of an estimate: flat JSON with every digit."""

from __future__ import annotations

import dataclasses
import json
from importlib.resources import files

import jsonschema
import numpy as np

from replant.live.outputs.message import ENDED, UNKNOWN, EstimateMessage
from support.cases import every
from support.live_views import estimate


def test_an_estimate_is_flat_json_with_every_digit() -> None:
    assert json.loads(estimate().as_json()) == {
        "schema_version": 1,
        "timestamp": 0.25, "sequence": 3, "samples": 4, "a0": 0.1 + 0.2, "b0": None, "std_a0": 1e-300, "std_b0": None,
        "trusted": 0, "excited": 1, "ttl": 0.0, "status": "starting", "verdict": "converging", "coefficients": 0,
        "sent": None,
    }  # fmt: skip
    assert "sequence" not in json.loads(estimate(None).as_json())


def test_defaults_of_a_message_claim_neither_excitation_nor_trust() -> None:
    """Whatever the verdict, the default is no excitation and no permission to use the model."""
    values = np.zeros(1)
    told = json.loads(EstimateMessage(0.0, None, 1, ("a0",), values, values, "running", "trusted").as_json())
    assert (told["excited"], told["trusted"], told["ttl"], told["sent"]) == (0, 0, 0.0, None)


def test_a_model_is_trusted_while_the_input_rests_and_both_are_told() -> None:
    resting = dataclasses.replace(estimate(), verdict="trusted", ttl=5.0, excited=False)
    told = json.loads(resting.as_json())
    assert (told["trusted"], told["excited"]) == (1, 0)


def test_coefficients_are_relied_upon_only_with_the_model() -> None:
    known = dataclasses.replace(estimate(), coefficients=True)
    trusted = dataclasses.replace(known, verdict="trusted", ttl=5.0)
    expired, whole = (dataclasses.replace(trusted, **change) for change in ({"ttl": 0.0}, {"coefficients": False}))
    told = [json.loads(one.as_json()) for one in (known, trusted, expired, whole)]
    assert [(one["trusted"], one["coefficients"]) for one in told] == [(0, 0), (1, 1), (0, 0), (1, 0)]


@every("sequence", [3, None])
@every("changes", [{}, {"verdict": UNKNOWN, "status": ENDED}, {"verdict": "trusted", "ttl": 5.0, "sent": 1e9}])
def test_every_message_is_as_its_schema_says(sequence: int | None, changes: dict[str, object]) -> None:
    schema = json.loads(files("replant.live.outputs").joinpath("schema/message-1.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    told = json.loads(dataclasses.replace(estimate(sequence), **changes).as_json())
    jsonschema.Draft202012Validator(schema).validate(told)


def test_a_message_that_was_stored_before_it_told_of_coefficients_is_as_its_schema_says() -> None:
    schema = json.loads(files("replant.live.outputs").joinpath("schema/message-1.json").read_text())
    told = json.loads(estimate().as_json())
    del told["coefficients"]
    jsonschema.Draft202012Validator(schema).validate(told)
