"""Pages that are made from the source are the present ones; `make pages` writes them anew."""

import sys

from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import architecture
import constants_page
import modules_page
import state_page


def test_the_picture_of_the_folders() -> None:
    drawn = (ROOT / "docs" / "pictures" / "architecture.svg").read_text(encoding="utf-8")
    assert drawn == architecture.picture(architecture.Package.read())


def test_the_page_of_the_state() -> None:
    assert state_page.PAGE.read_text(encoding="utf-8") == state_page.page()


def test_the_page_of_the_modules() -> None:
    assert modules_page.PAGE.read_text(encoding="utf-8") == modules_page.page()


def test_the_page_of_the_constants() -> None:
    assert constants_page.PAGE.read_text(encoding="utf-8") == constants_page.page()


@every("module", lambda: sorted({found.module for found in constants_page.constants()}))
def test_every_numeric_constant_says_what_it_means_and_a_tuned_one_why(module: str) -> None:
    lacking = [found.names for found in constants_page.constants() if found.module == module and not found.is_complete]
    assert not lacking


def test_the_constants_of_the_estimators_are_found() -> None:
    """Else the tests above would pass with nothing looked at."""
    found = {(one.module, name) for one in constants_page.constants() for name in one.names}
    assert {("kernels.monitoring.outliers", "GATE"), ("assessment.alternatives", "LARGEST_PART")} <= found
