"""What was imported from `replant.online.checkpoint` still comes, with a word on what to write instead."""

import pytest

from replant.online import checkpoint, saving


@pytest.mark.parametrize("name", ["Loaded", "load", "save"])
def test_the_old_name_is_the_new_one_and_says_so(name: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"write replant.online.saving.{name}"):
        found = getattr(checkpoint, name)
    assert found is getattr(saving, name)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'unknown'"):
        _ = checkpoint.unknown
