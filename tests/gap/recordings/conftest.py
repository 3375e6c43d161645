"""The robots' runs, driven once a session."""

import pytest

from .robots import ARM, QUADRUPED, Log, drive


@pytest.fixture(scope="session")
def arm() -> Log:
    return drive(ARM)


@pytest.fixture(scope="session")
def quadruped() -> Log:
    return drive(QUADRUPED, seconds=3.0)
