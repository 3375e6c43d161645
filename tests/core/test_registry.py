"""A name that a registry does not have."""

from __future__ import annotations

import pytest

from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry


@pytest.mark.parametrize("group", ["", "realsim.effects"])
def test_what_packages_may_add_is_looked_for_in_packages(group: str) -> None:
    with pytest.raises(UnknownNameError) as caught:
        Registry("effect", {"play": "nowhere:PLAY"}, group)["quadratic_drag"]
    assert ("realsim.effects" in str(caught.value)) == bool(group)
    assert "play" in str(caught.value)
