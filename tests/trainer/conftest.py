"""Nothing here runs without torch."""

import pytest

pytest.importorskip("torch", reason="the trainer needs torch (extra: train)")
