"""Docstrings of the public interface: each name has one, and numpydoc finds nothing to mend in it.

    python tools/docstrings.py

It prints each fault with its name; no fault, no output.  The checks of numpydoc that are not made, and why:

* ES01, SA01, SA04: a summary that says all needs neither more words nor other names.
* EX01: an example stands where it teaches something; that of a class shows its methods.
* PR07, RT03: a parameter or result whose name and type say all needs no description, as ``path : path``.
* SA03: the house writes what follows a colon in small letters.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from typing import Any

from numpydoc.validate import validate

import replant

NOT_MADE = {"ES01", "SA01", "SA03", "SA04", "EX01", "PR07", "RT03"}
#: What an optimizer tells the kernels: arguments and results are documented once, in `Optimizer`.
OF_EVERY_OPTIMIZER = {"begins_with", "check", "memory", "settings", "suggested"}
#: Modules whose functions are public beside the names of `replant` itself.
MODULES = ("replant.examples", "replant.report.figures", "replant.rigs", "replant.signals")
#: Public classes that are results of public functions, or stand in a module of their own.
CLASSES = (
    "replant.verdict.verdict.Assessment",
    "replant.verdict.verdict.Verdict",
    "replant.fitting.responses.Bode",
    "replant.fitting.responses.ImpulseResponse",
    "replant.fitting.responses.Nyquist",
    "replant.fitting.responses.PoleMap",
    "replant.fitting.responses.StepResponse",
    "replant.fitting.validation.ErrorByFrequency",
    "replant.model.transfer_function.Mode",
    "replant.fitting.search_result.Candidate",
    "replant.fitting.search_result.MatrixSearch",
    "replant.fitting.search_result.SearchResult",
    "replant.online.runs.result.History",
    "replant.online.runs.result.Result",
    "replant.estimation.settings.Settings",
)


def public() -> Iterator[tuple[str, Any]]:
    """Every public class and function with its path."""
    for name in replant.__all__:
        thing = getattr(replant, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            yield f"replant.{name}", thing
    for module in MODULES:
        for name, thing in vars(importlib.import_module(module)).items():
            if inspect.isfunction(thing) and thing.__module__.startswith(module) and not name.startswith("_"):
                yield f"{module}.{name}", thing
    for path in CLASSES:
        module, _, name = path.rpartition(".")
        yield path, getattr(importlib.import_module(module), name)


def members(path: str, thing: Any) -> Iterator[tuple[str, Any]]:
    """The methods and properties of a class that are ours."""
    for name, member in inspect.getmembers(thing) if inspect.isclass(thing) else ():
        function = member.fget if isinstance(member, property) else inspect.unwrap(member)
        ours = getattr(function, "__module__", None) or ""
        if (
            not name.startswith("_")
            and callable(function)
            and ours.startswith("replant")
            and not inspect.isclass(member)
        ):
            yield f"{path}.{name}", member


def is_excused(code: str, thing: Any) -> bool:
    """Whether a finding is none: a summary alone says what comes in and out; fields of a class are its attributes."""
    doc = inspect.getdoc(thing) or ""
    sections = re.findall(r"^(\w[\w ]*)\n-{3,}$", doc, re.MULTILINE)
    if code == "PR01":
        return not sections or (inspect.isclass(thing) and "Attributes" in sections)
    return code in ("RT01", "YD01") and bool(re.search(r"\b(return|give)", doc.splitlines()[0], re.IGNORECASE))


def faults() -> Iterator[str]:
    """Yield what is to be mended, a line each."""
    for name, whole in public():
        for path, thing in [(name, whole), *members(name, whole)]:
            if not (inspect.getdoc(thing) or "").strip():
                yield f"{path} has no docstring"
                continue
            leave_out = NOT_MADE | {"PR01", "RT01"} if path.rpartition(".")[2] in OF_EVERY_OPTIMIZER else NOT_MADE
            for code, text in validate(path)["errors"]:
                if code not in leave_out and not is_excused(code, thing):
                    yield f"{path}: {code} {text}"


if __name__ == "__main__":
    sys.exit("\n".join(faults()) or 0)
