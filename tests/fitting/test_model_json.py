"""A model as JSON: to the bit and back, by its schema, and every file that is none gives a reason."""

from __future__ import annotations

import copy
import dataclasses
import json
import math
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import replant as rp
from replant.fitting.model_fields import Provenance
from replant.fitting.model_json import as_object
from replant.verdict.verdict import STATUSES, Verdict
from support.cases import every, examples

SCHEMA = json.loads(files("replant.fitting").joinpath("schema/model-1.json").read_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
sizes = st.floats(0.0, 1e300)
texts = st.text(max_size=20).filter(lambda text: not any("\ud800" <= letter <= "\udfff" for letter in text))


def product(root: np.ndarray) -> np.ndarray:
    """A covariance, symmetric to the bit."""
    found = root @ root.T
    return np.asarray(np.tril(found) + np.tril(found, -1).T)


@st.composite
def models(draw: Any) -> rp.Model:
    poles = draw(st.integers(1, 4))
    structure = rp.Structure(
        poles, draw(st.integers(0, poles - 1)), draw(st.just(0.0) | st.floats(1e-30, 1e3)), draw(st.booleans())
    )
    size = structure.size
    parameters = draw(st.lists(st.floats(-1e100, 1e100), min_size=size, max_size=size))
    covariance = draw(st.none() | st.lists(st.floats(-1e100, 1e100), min_size=size * size, max_size=size * size))
    noise = draw(st.none() | st.lists(st.floats(-2.0, 2.0), max_size=3))
    return rp.Model(
        structure,
        parameters,
        draw(st.floats(1e-12, 1e12)),
        covariance=None if covariance is None else product(np.reshape(covariance, (size, size))),
        noise=None if noise is None else rp.NoiseModel(np.array([1.0, *noise]), draw(sizes), draw(sizes), 0.1),
        input_hold=draw(st.sampled_from(["zoh", "foh"])),
        input_map=draw(st.sampled_from(["identity", "square"])),
        input_level=draw(numbers),
        output_level=draw(numbers),
        input_name=draw(texts),
        output_name=draw(texts),
        simulated_fit=draw(st.floats(-1e6, 100.0) | st.just(math.nan)),
        one_step_fit=draw(st.floats(-1e6, 100.0) | st.just(math.nan)),
        rejected=tuple(draw(st.dictionaries(texts, st.integers(0, 10**9), max_size=2)).items()),
        verdict=Verdict(draw(st.sampled_from(STATUSES)), tuple(draw(st.lists(texts, max_size=2))), draw(st.booleans())),
        provenance=Provenance("srivc", draw(texts), "", draw(st.integers(0, 10**12))),
    )


@settings(max_examples=examples(150))
@given(models())
def test_there_and_back_to_the_bit_and_by_the_schema(model: rp.Model) -> None:
    written = model.to_json()
    assert rp.Model.from_json(written) == model
    assert rp.Model.from_json(written).provenance.date == model.provenance.date
    VALIDATOR.validate(json.loads(written))


def test_a_covariance_is_read_back_where_a_variance_is_too_small_for_float64() -> None:
    spread = np.array([1e-170, 0.0, 1.0, 2.0])
    model = replace(PLAIN, covariance=np.outer(spread, spread))
    assert model.covariance[0, 0] == 0.0 < model.covariance[0, 2]
    assert rp.Model.from_json(model.to_json()) == model


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert set(SCHEMA["required"]) == set(as_object(PLAIN))


PLAIN = rp.Model(
    rp.Structure(2, 1), [4.0, 3.0, 1.0, 2.0], 0.1, covariance=np.eye(4), noise=rp.NoiseModel([1.0, 0.5], 1.0, 2.0, 0.1)
)
OBJECT = as_object(PLAIN)


def paths(where: Any, before: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in an object of JSON."""
    items = where.items() if isinstance(where, dict) else enumerate(where) if isinstance(where, list) else ()
    return [path for key, value in items for path in ((*before, key), *paths(value, (*before, key)))]


@every("path", paths(OBJECT), ids=lambda path: "/".join(map(str, path)))
@every("value", [None, "x", -1, 1e999, [], {}, True, 10**400, "missing"], ids=lambda value: repr(value)[:9])
def test_any_entry_of_another_kind_gives_a_model_or_a_reason(path: tuple[Any, ...], value: Any) -> None:
    changed = copy.deepcopy(OBJECT)
    where = changed
    for key in path[:-1]:
        where = where[key]
    if value == "missing":
        del where[path[-1]]
    else:
        where[path[-1]] = value
    reason = ""
    try:
        rp.Model.from_json(json.dumps(changed))
    except rp.ModelFileError as error:
        reason = str(error)
    assert "\n" not in reason


@every(
    ("changes", "words"),
    [
        ({"schema_version": 4}, "install a newer replant"),
        ({"schema_version": 0}, "must be 1 or more"),
        ({"schema_version": True}, "'schema_version' must be a whole number"),
        ({"dt": "0.1"}, "'dt' must be a number"),
        ({"dt": 0}, "dt"),
        ({"num": [1.0, 2.5]}, "'num' contradicts"),
        ({"den": [1.0]}, "'den' contradicts"),
        ({"parameters": {}}, "'parameters' must be a1, a0, b1, b0"),
        ({"covariance": [[1.0]]}, "'covariance' must be 4 lists"),
        ({"covariance": np.diag([1.0, 1.0, 1.0, -1.0]).tolist()}, "'covariance' is not valid"),
        ({"covariance": (np.eye(4) + np.eye(4, k=1)).tolist()}, "'covariance' is not valid"),
        ({"delay": 9.0}, "'delay' contradicts"),
        ({"samples": 10**30}, "'samples' is too large"),
        ({"verdict": {"status": "good", "excited": True, "reasons": []}}, "status must be one of"),
    ],
)
def test_what_is_wrong_is_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(rp.ModelFileError, match=words):
        rp.Model.from_json(json.dumps({**OBJECT, **changes}))


@every(
    ("written", "words"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ('{"dt": NaN}', "NaN is no number"),
        (b"\xff\xfe\x00", "not JSON"),
        ("[]", "holds no model"),
        ("{}", "holds no model"),
        ('{"num": [1], "den": [1, 1]}', "no 'schema_version'"),
        ('{"dt": 1, "dt": 2}', "'dt' comes twice"),
    ],
)
def test_what_is_no_model_is_said(written: Any, words: str) -> None:
    with pytest.raises(rp.ModelFileError, match=words):
        rp.Model.from_json(written)


def test_entries_of_a_later_minor_version_are_passed_over() -> None:
    assert rp.Model.from_json(json.dumps({**OBJECT, "colour": "red"})) == PLAIN


def test_a_function_cannot_be_written() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="Python function"):
        dataclasses.replace(PLAIN, input_map=np.sqrt).to_json()


def test_files(tmp_path: Path) -> None:
    file = tmp_path / "motor.json"
    PLAIN.save(file)
    assert rp.load_model(file) == PLAIN
    assert [path.name for path in tmp_path.iterdir()] == ["motor.json"]
    for path, words in (
        (tmp_path / "none.json", "no such file"),
        (tmp_path, "no model"),
        ("\0", "no such file"),
    ):
        with pytest.raises(rp.ModelFileError, match=words):
            rp.load_model(path)
    file.write_text("{}")
    with pytest.raises(rp.ModelFileError, match=r"motor\.json: it holds no model"):
        rp.load_model(file)
    for path, words in (
        (tmp_path, "exists and is no model"),
        (tmp_path / "no" / "m.json", "there is no folder"),
        ("\0", "could not be written"),
    ):
        with pytest.raises(rp.ModelFileError, match=words):
            PLAIN.save(path)
    log = tmp_path / "log.csv"
    log.write_text("t,u,y\n")
    with pytest.raises(rp.ModelFileError, match=r"log\.csv: it exists and is no model"):
        PLAIN.save(log)
    assert log.read_text() == "t,u,y\n"
    PLAIN.save(file := tmp_path / "again.json")
    PLAIN.save(file)  # a model may take the place of one
