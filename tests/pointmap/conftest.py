"""Nothing here runs without torch."""

import pytest

pytest.importorskip("torch", reason="the network is torch's (extra: train)")
