"""What `make lint` runs beside ruff finds the faults that it is for, and none in what is right."""

from __future__ import annotations

import ast
import re
import sys
from functools import cache
from pathlib import Path

import pytest

import replant
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import architecture
import constants_page
import docstrings
import imports
import pages
from architecture import Package, circle, levels, reduced


@cache
def whole() -> Package:
    """The package under test: to parse it takes seconds."""
    return Package.read()


# --- imports

#: A module, its text, and the fault that is to be found.
FAULTY = [
    ("kernels.a", "import json", "imports json"),
    ("kernels.a", "from replant.online import b", "imports online, a kernel"),
    ("online.b", "import scipy.signal", "imports scipy at its top"),
    ("online.b", "import replant.sklearn", "imports sklearn at its top, which is heavy"),
    ("online.b", "def f():\n    import pathlib", "imports pathlib: it reaches the outside"),
    ("online.b", "import click", "imports click: it reaches the outside"),
    ("online.b", "print(1)", "line 1: calls print()"),
    ("online.b", "x = 1\nx.savetxt('a')", "line 2: uses savetxt"),
    ("report.c", "import requests", "imports requests: declare it"),
    ("online.b", "from replant import __version__", "imports replant itself"),
    (
        "online.b",
        "from replant.numerics.arguments import positive\npositive(1)",
        "line 2: keep() what positive() returns",
    ),
    ("online.b", "def f():\n    from replant.report import c", "makes a circle: online.b -> report.c -> online.b"),
    ("report.c", "import replant.report", "makes a circle: report.c -> report -> report.c"),
    ("online.b", f"def f({', '.join(f'a{k}' for k in range(13))}): ...", "line 1: f takes more than 12"),
]
RIGHT = {
    "__init__": "__version__ = '1'",
    "numerics.__init__": "",
    "numerics.arguments": "def positive(x): return x\ndef keep(x): return x",
    "kernels.__init__": "",
    "kernels.a": "import math\nimport numpy as np\n",
    "online.__init__": "",
    "online.b": "import numpy\ndef f():\n    import scipy\n    x = positive(1)\n    keep(x)\n",
    "report.__init__": "from replant.report import c",
    "report.c": "from pathlib import Path\nimport replant.online.b\nprint(Path())\n",
    "sklearn": "import sklearn\n",
}


def package(folder: Path, **changed: str) -> Package:
    """A package of these modules."""
    for name, text in {**RIGHT, **changed}.items():
        path = folder.joinpath(*name.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return Package.read(folder)


def test_a_right_package_has_no_faults(tmp_path: Path) -> None:
    assert imports.faults(package(tmp_path)) == []


@every(("module", "text", "fault"), FAULTY)
def test_each_fault_of_a_module_is_found(module: str, text: str, fault: str, tmp_path: Path) -> None:
    found = imports.faults(package(tmp_path, **{module: text}))
    assert any(each.startswith(f"{module}: ") and fault in each for each in found), found


@pytest.mark.slow
def test_the_reader_of_imports_sees_every_kind() -> None:
    tree = ast.parse(
        "import numpy as np, scipy.signal\nfrom replant.kernels import schema as at\n"
        "from replant.estimation import settings\n"
        "from replant import __version__\nif np:\n    import sympy\n"
        "class A:\n    import pandas\ndef f():\n    import control\n    g = lambda: __import__('os')\n"
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import pyarrow\n"
    )
    early = ["numpy", "scipy.signal", "replant.kernels.schema", "replant.estimation.settings", "replant"]
    early += ["sympy", "pandas", "typing"]
    assert list(whole().imports(tree, "online.identifier", late=False)) == early
    assert set(whole().imports(tree, "online.identifier")) == {*early, "control", "pyarrow"}
    relative = ast.parse("from . import stages\nfrom .stages import step\nfrom ..schema import PAST")
    assert list(whole().imports(relative, "kernels.step.ensemble")) == [
        "replant.kernels.step.stages",
        "replant.kernels.step.stages",
        "replant.kernels.schema",
    ]
    assert list(whole().imports(ast.parse("from .step import stages"), "kernels")) == ["replant.kernels.step.stages"]


def test_levels_and_arrows_of_a_small_graph() -> None:
    graph = {"a": {"b", "c"}, "b": {"c"}, "c": set()}
    assert levels(graph) == {"a": 2, "b": 1, "c": 0}
    assert reduced(graph) == {"a": {"b"}, "b": {"c"}, "c": set()}
    assert circle(graph) == set()
    assert circle({"a": {"b"}, "b": {"a"}, "c": set()}) == {"a", "b"}


def test_the_picture_changes_with_the_folders(tmp_path: Path) -> None:
    before = architecture.picture(package(tmp_path))
    assert architecture.picture(package(tmp_path, **{"numerics.arguments": "import replant.sklearn"})) != before


def test_the_package_that_is_looked_at_is_the_one_under_test_and_has_checks_whose_results_count() -> None:
    """Else the checks of `make lint` would find no fault because they look at nothing."""
    assert Path(replant.__file__).parent == architecture.SOURCE
    assert {"online.identifier", "kernels", "kernels.step"} <= set(whole().files)
    assert {"positive", "finite", "record"} <= imports._checks(whole())


# --- pages

INDEX = "# Docs\n\n*Where is it?*\n\n```{toctree}\nhow-to/index\nfree\n```\n"
SITE = {
    "README.md": "[a](docs/free.md#a-heading)\n",
    "docs/index.md": INDEX,
    "docs/free.md": "# Free\n\n*What is free?*\n\n## A heading\n\n<!-- not run: it waits -->\n```sh\nsleep 1\n```\n",
    "docs/how-to/index.md": "# How to\n\n*How?*\n",
    "docs/how-to/cell.md": pages.HEADER + "\n# Cell\n\n*Which\ncell?*\n\n```{code-cell} python\n1\n```\n",
}
#: A page, its text, and the fault that is to be found.
FAULTY_PAGES = [
    ("docs/free.md", "Free\n", "does not begin with a title"),
    ("docs/free.md", "# Free\n\nIt is free.\n", "a question in italics"),
    ("docs/free.md", "# Free\n\n*Free?*\n\n```python\nx = 1\n```\n", "'x = 1' is not run"),
    ("docs/how-to/cell.md", "# Cell\n\n*Cell?*\n\n```{code-cell} python\n1\n```\n", "not the header"),
    ("docs/free.md", "# Free\n\n*Free?*\n\n[a](gone.md)\n", "[a](gone.md) leads nowhere"),
    ("docs/free.md", "# Free\n\n*Free?*\n\n[a](index.md#gone)\n", "index.md has no such heading"),
    ("docs/free.md", "# Free\n\n*Free?*\n\n![a](a.png)\n", "![a](a.png) leads nowhere"),
    ("docs/free.md", "# Free\n\n*Free?*\n\n{download}`a <a.csv>`\n", "leads nowhere"),
    ("README.md", "[a](docs/free.md#other)\n", "free.md has no such heading"),
    ("docs/lost.md", "# Lost\n\n*Where?*\n", "stands in no index.md"),
    ("docs/alone/page.md", "# Alone\n\n*Where?*\n", "without an index.md"),
]


def site(folder: Path, **changed: str) -> pages.Pages:
    for name, text in {**SITE, **changed}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return pages.Pages(folder)


def of_pages(found: pages.Pages) -> list[str]:
    return [fault for fault in pages.faults(found) if not fault.startswith("docs/reference: ")]


def test_right_pages_have_no_faults(tmp_path: Path) -> None:
    assert of_pages(site(tmp_path)) == []


@every(("page", "text", "fault"), FAULTY_PAGES)
def test_each_fault_of_a_page_is_found(page: str, text: str, fault: str, tmp_path: Path) -> None:
    found = of_pages(site(tmp_path, **{page: text}))
    assert any(each.startswith(f"{page}: ") and fault in each for each in found), found


def test_a_name_that_is_not_in_the_reference_is_named(tmp_path: Path) -> None:
    reference = {"docs/reference/index.md": "# Reference\n\n*What?*\n\n.. autoclass:: Identifier\n"}
    found = [fault for fault in pages.faults(site(tmp_path, **reference)) if "is not documented" in fault]
    assert "docs/reference: replant.fit is not documented" in found
    assert not any("replant.Identifier " in fault for fault in found)


# --- docstrings and constants


def test_a_docstring_that_lacks_a_parameter_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def one() -> None:
        pass

    monkeypatch.setattr(docstrings, "public", lambda: iter([("replant.fit", one)]))
    assert list(docstrings.faults()) == ["replant.fit has no docstring"]


def test_the_public_names_are_found() -> None:
    paths = {path for name, whole in docstrings.public() for path in (name, *dict(docstrings.members(name, whole)))}
    assert {"replant.Identifier.update", "replant.signals.prbs", "replant.report.figures.draw_bode"} <= paths


CONSTANT = '''
LIMIT = 3.0
"""Largest ratio [1].
Origin: a choice.
Sensitivity: not measured.
"""
'''


@pytest.mark.parametrize(
    ("left_out", "put"), [(" [1]", ""), ("Origin: a choice.\n", ""), ("Sensitivity: not measured.\n", ""),
                          ("a choice", "not recorded")],
)  # fmt: skip
def test_a_tuned_constant_that_lacks_a_part_of_its_string_is_named(
    left_out: str, put: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "module.py").write_text(CONSTANT.replace(left_out, put), encoding="utf-8")
    monkeypatch.setattr(constants_page, "SOURCE", tmp_path)
    monkeypatch.setattr(constants_page, "PAGE", tmp_path / "constants.md")
    monkeypatch.setattr(constants_page, "ROOT", tmp_path)
    monkeypatch.setattr(constants_page, "constants", constants_page.constants.__wrapped__)
    constants_page.PAGE.write_text("old", encoding="utf-8")
    found = constants_page.faults()
    assert re.match(r"module, line 2: LIMIT lacks", found[0])
    assert found[-1] == "constants.md is not the present one: make pages"


def test_a_constant_with_all_parts_is_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "module.py").write_text(CONSTANT, encoding="utf-8")
    monkeypatch.setattr(constants_page, "SOURCE", tmp_path)
    monkeypatch.setattr(constants_page, "constants", constants_page.constants.__wrapped__)
    assert "1 constants are tuned" in constants_page.page()
    assert ": `LIMIT` = 3.0 [1]: Largest ratio. Not measured." in constants_page.page()


def test_the_constants_of_the_estimators_are_found() -> None:
    found = {(one.module, name) for one in constants_page.constants() for name in one.names}
    assert {("kernels.monitoring.outliers", "GATE"), ("numerics.levels", "LARGEST_PART")} <= found


def test_a_comment_says_what_a_plain_fact_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "module.py").write_text("PORT = 1883  # port of a broker [number]\nBARE = 2\n", encoding="utf-8")
    monkeypatch.setattr(constants_page, "SOURCE", tmp_path)
    port, bare = constants_page.constants.__wrapped__()
    assert (port.meaning, port.unit, port.is_complete) == ("port of a broker", "number", True)
    assert not bare.is_complete
