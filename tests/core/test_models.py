"""What is said of models that cannot be simulated."""

from pathlib import Path

import pytest

from realsim.core.errors import GapError
from realsim.gap.case.case import load_model
from realsim.gap.recordings.model import load_target

MESH = """<mujoco><asset><mesh name="m" file="base.obj"/></asset><worldbody><body><freejoint/>
<geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("load", [load_model, load_target])
def test_a_model_without_its_meshes_is_told_what_to_do(load, tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(MESH)
    with pytest.raises(GapError) as caught:
        load(tmp_path / "robot.xml")
    assert "base.obj" in str(caught.value.found)
    assert "meshes" in str(caught.value.hint)


@pytest.mark.parametrize("load", [load_model, load_target])
def test_an_actuator_of_a_joint_that_is_not_there_is_no_model_without_it(load, tmp_path: Path) -> None:
    """MjSpec.copy() drops it."""
    body = '<body><joint name="j"/><geom size="0.1" mass="1"/></body>'
    actuator = '<actuator><motor joint="k"/></actuator>'
    (tmp_path / "robot.xml").write_text(f"<mujoco><worldbody>{body}</worldbody>{actuator}</mujoco>")
    with pytest.raises(GapError, match="does not compile") as caught:
        load(tmp_path / "robot.xml")
    assert "'k'" in str(caught.value.found)


def test_other_errors_of_a_model_have_another_hint(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text("<mujoco><worldbody><body><freejoint/></body></worldbody></mujoco>")
    with pytest.raises(GapError) as caught:
        load_target(tmp_path / "robot.xml")
    assert "mend it until MuJoCo loads it" in str(caught.value.hint)
