"""Pages that are made from the source are the present ones; `make pages` writes them anew."""

import sys

from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import architecture
import state_page


def test_the_picture_of_the_folders() -> None:
    drawn = (ROOT / "docs" / "pictures" / "architecture.svg").read_text(encoding="utf-8")
    assert drawn == architecture.picture(architecture.Package.read())


def test_the_page_of_the_state() -> None:
    assert state_page.PAGE.read_text(encoding="utf-8") == state_page.page()
