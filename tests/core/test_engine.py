"""A MuJoCo that computes wrong results is refused; others pass."""

import pytest

import realsim as rs
from realsim.cli.command_line import main
from realsim.core import engine


@pytest.mark.parametrize("version", ["3.11.0", "3.17.0", "4.0.1", "4.1.0"])
def test_sound_versions_pass(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "mujoco_version", lambda: version)
    engine.check_mujoco()


def test_the_broken_one_is_refused_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engine, "mujoco_version", lambda: "4.0.0")
    assert main(["diagnose", "case"]) == 2
    said = capsys.readouterr().err
    assert "sparse Cholesky" in said
    assert "!=4.0.0" in said
    with pytest.raises(rs.RealsimError, match="sparse Cholesky"):
        rs.diagnose("case")
