"""The script and style sheet of uPlot, which draws the plots over time of report and dashboard.

They belong to the package but not to the repository: `hatch_build.py` fetches them when the package is built.  Where
that failed, those of the package uplot-python are used.
"""

from __future__ import annotations

import importlib.util
from functools import cache
from importlib import resources
from pathlib import Path

from replant.errors import MissingDependencyError

OWN = "uPlot.iife.min.js", "uPlot.min.css"
UPLOT_PYTHON = "uPlot.iife.js", "uPlot.min.css"


@cache
def uplot() -> tuple[str, str]:
    """Return uPlot's script and style sheet."""
    own = resources.files("replant.report").joinpath("assets", "uplot")
    places = [(own, OWN)]
    spec = importlib.util.find_spec("uplot")  # need not be imported for its files
    places += [(Path(folder, "static"), UPLOT_PYTHON) for folder in (spec and spec.submodule_search_locations) or ()]
    for folder, names in places:
        script, style = (folder.joinpath(name) for name in names)
        if script.is_file() and style.is_file():
            return script.read_text(encoding="utf-8"), style.read_text(encoding="utf-8")
    raise MissingDependencyError(
        "the report and the dashboard need uPlot, which was not fetched when replant was installed: "
        "install npm and then replant once more, or: pip install --no-deps uplot-python"
    )
