"""A RealSense library for all tests of captures, and a cache of their own."""

import sys

import pytest

from . import fake_realsense


@pytest.fixture(autouse=True)
def realsense(monkeypatch, tmp_path_factory):
    """The stand-in under the library's name, with no camera plugged in."""
    monkeypatch.setitem(sys.modules, "pyrealsense2", fake_realsense)
    monkeypatch.setenv("REALSIM_CACHE", str(tmp_path_factory.mktemp("cache")))
    for state in ("plugged_in", "breaks_after", "interrupts_after", "calls"):
        monkeypatch.setattr(fake_realsense, state, [])
    return fake_realsense
