"""Laws that every effect of the library keeps, and the check that matters: found where injected, absent where not."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import realsim.gap
from realsim.core.errors import RealsimError
from realsim.gap import EFFECTS, DiagnoseConfig, diagnose, explain, load_case
from realsim.gap.effects import Effects
from realsim.gap.simulation.simulate import Simulator

from .test_passive import GRIPPER, TIME, case_of
from .test_recovery import UNSEEN
from .truth import ARM, Truth, make_case

CONTRACT = sorted(EFFECTS.own)

RIVALS = ("stiffness_gain", "coulomb_friction")


def test_an_effect_is_one_file() -> None:
    """Nothing else of the engine knows it by its name."""
    same = {  # words of another meaning
        "case/model/context.py": "armature",  # of MuJoCo's joints
        "case/setups.py": "payload",  # that a run is known to carry
        "experiments/write.py": "payload",
        "answer/patch.py": "external_force",  # a wrapper
    }
    root = Path(realsim.gap.__file__).parent
    found = [
        f"{name}: {node.value}"
        for path in root.rglob("*.py")
        if not (name := path.relative_to(root).as_posix()).startswith("effects/")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in EFFECTS and node.value != same.get(name)
    ]
    assert not found


@pytest.mark.parametrize("name", CONTRACT)
def test_every_effect_explains_itself(name: str) -> None:
    text = explain(name)
    assert name in text
    assert "looks like" in text
    assert EFFECTS[name].name == name


@pytest.fixture(scope="module")
def simulator(made):
    with Simulator(load_case(made(Truth())), DiagnoseConfig()) as found:
        yield found


@pytest.fixture(scope="module")
def walking(quadruped):
    with Simulator(quadruped, DiagnoseConfig()) as found:
        yield found


@pytest.fixture(scope="module")
def flying(hovering):
    with Simulator(hovering, DiagnoseConfig()) as found:
        yield found


@pytest.fixture(scope="module")
def gripping(tmp_path_factory: pytest.TempPathFactory):
    opens = [0.02 + 0.012 * np.sin(2 * np.pi * f * TIME) for f in (0.4, 0.9)]
    with Simulator(case_of(tmp_path_factory.mktemp("gripper"), GRIPPER, "position", opens), DiagnoseConfig()) as found:
        yield found


@pytest.fixture
def somewhere(name: str, simulator: Simulator, walking: Simulator, flying: Simulator, gripping: Simulator):
    """A robot on which the effect has places, and these; effects of the ground and the IMU need one that walks."""
    place = EFFECTS[name].places
    robots = (simulator, walking, flying, gripping)
    found = next(((s, place(s.context)) for s in robots if place(s.context)), (simulator, []))
    assert bool(found[1]) != (name in UNSEEN)
    return found


@pytest.mark.parametrize("name", CONTRACT)
def test_nothing_changes_at_the_nominal_values(name: str, somewhere: tuple[Simulator, list]) -> None:
    robot, places = somewhere
    nominal = robot.simulate()
    for place in places[:4]:
        again = robot.simulate([(name, place, {})])
        for a, b in zip(nominal, again, strict=True):
            np.testing.assert_allclose(a, b, atol=2e-6)


@pytest.mark.parametrize("name", CONTRACT)
def test_parameters_are_well_formed(name: str, somewhere: tuple[Simulator, list]) -> None:
    effect = EFFECTS[name]
    simulator, places = somewhere
    for place in places:
        for p in effect.parameters(simulator.context, place):
            assert p.bounds[0] <= p.default <= p.bounds[1]
            assert p.bounds[0] <= max(min(p.default + p.step, p.bounds[1]), p.default - p.step)
            assert p.step != 0
            assert p.unit
            assert np.isfinite(p.report(p.default))
        assert effect.excited_by(simulator.context, place).reason


def test_a_payload_is_compared_with_the_centre_of_mass_that_it_shifts(simulator: Simulator) -> None:
    """The centre of mass of a pendulum's rod, 42 mm off, was `identified` as a mass at its end."""
    values = {"mass": 0.5, "x": 0.02, "y": 0.0, "z": -0.3}
    found = EFFECTS["payload"].rivals.suggest(simulator.context, ("fore",), values)
    body = simulator.context.case.model.body("fore")
    shift = 0.5 * (np.array([0.02, 0.0, -0.3]) - body.ipos) / (body.mass[0] + 0.5)
    own = [s.values for s in found if (s.effect, s.place) == ("com_offset", ("fore",))]
    assert own == [pytest.approx(dict(zip("xyz", shift, strict=True))), {"z": pytest.approx(shift[2])}]


def test_a_payload_near_a_joint_does_nearly_the_same_on_both_links(simulator: Simulator) -> None:
    payload = EFFECTS["payload"]
    values = {"mass": 0.5, "x": 0.0, "y": 0.0, "z": 0.01}  # 1 cm above the elbow
    *_, found = payload.rivals.suggest(simulator.context, ("fore",), values)
    place, moved = found.place, found.values
    assert place == ("upper",)
    assert moved == pytest.approx({"mass": 0.5, "x": 0.0, "y": 0.0, "z": -0.39})
    changes = [
        np.concatenate(simulator.simulate([("payload", p, v)])) - np.concatenate(simulator.simulate())
        for p, v in ((("fore",), values), (place, moved))
    ]
    assert np.nanstd(changes[0] - changes[1]) < 0.1 * np.nanstd(changes[0])


def test_camera_effects_say_why_they_are_not_tried(simulator: Simulator) -> None:
    for name in ("camera_delay", "camera_mount", "depth_noise"):
        excitation = EFFECTS[name].excited_by(simulator.context, ())
        assert not excitation.yes
        assert "camera" in excitation.reason


def install(folder: Path, **sources: str) -> None:
    """A package with effects, as pip would leave it."""
    (folder / "my_robot").mkdir()
    (folder / "my_robot-1.0.dist-info").mkdir()
    (folder / "my_robot-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: my-robot\nVersion: 1.0\n")
    points = "[realsim.effects]\n" + "".join(f"{name} = my_robot.{name}:EFFECT\n" for name in sources)
    (folder / "my_robot-1.0.dist-info" / "entry_points.txt").write_text(points)
    for name, source in sources.items():
        (folder / "my_robot" / f"{name}.py").write_text(source)


BROKEN = """
from realsim.gap.effects.base import JOINTS, Effect, Parameter, fixed

EFFECT = Effect(
    name="broken_spring",
    where=JOINTS,
    parameters=fixed(Parameter("stiffness", "N m/rad", (0.0, 50.0), 1.0)),
    apply=lambda edit, place, values: {}["nothing"],
)
"""


def test_effects_of_an_installed_package(tmp_path: Path) -> None:
    """The one of docs/extending.md, a spring at the elbow of which the model knows nothing, is found where it was
    injected. One that fails is named with its package: neither a traceback nor a candidate left out without a word."""
    page = (Path(realsim.__file__).parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")
    (source,) = (block for block in page.split("```python\n")[1:] if "return_spring" in block)
    install(tmp_path, return_spring=source.partition("```")[0], broken_spring=BROKEN)
    spring = ARM.replace('name="elbow"', 'name="elbow" stiffness="6"')
    folder = make_case(tmp_path / "case", spring, Truth(), runs=3, seed=3, span=(2.6, 3.2))
    (folder / "model.xml").write_text(ARM)
    commands = [
        ["diagnose", folder, "--out", tmp_path / name, "--effects", name, *RIVALS, "--bootstrap", "50"]
        for name in ("broken_spring", "return_spring")
    ]
    commands.append(["diagnose", "--explain", "broken_spring"])
    code = "import json, sys\nfrom realsim.cli.command_line import main\nfor command in json.loads(sys.argv[1]): "
    code += "print('exit code', main(command), flush=True)"
    paths = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH"))))
    arguments = [sys.executable, "-c", code, json.dumps([list(map(str, command)) for command in commands])]
    run = subprocess.run(arguments, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True)
    _, failed, found, explained = run.stdout.split("exit code ")
    assert failed.startswith("2\n"), run.stderr
    assert found.startswith("0\n"), run.stderr
    assert explained == "0\n"
    for text in ("`apply` of the effect 'broken_spring'", "KeyError: 'nothing'", "my_robot.broken_spring:EFFECT"):
        assert text in " ".join(run.stderr.split())
    assert not (tmp_path / "broken_spring").exists()
    assert "looks like" not in found  # it has no words for that
    assert "\n\n\n" not in found
    said = json.loads((tmp_path / "return_spring" / "diagnosis.json").read_text())
    assert said["verdict"] == "identified"
    (cause,) = said["causes"]
    assert (cause["effect"], cause["joints"]) == ("return_spring", ["elbow"])
    assert cause["parameters"]["stiffness"]["value"] == pytest.approx(6, rel=0.1)
    assert said["sentence"].startswith("Your model lacks return spring of ")


@pytest.mark.parametrize("source", ["EFFECT = 3", "", "import nothing_of_that_name"])
def test_an_installed_package_without_an_effect_is_refused(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, return_spring=source)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_robot", raising=False)
    monkeypatch.delitem(sys.modules, "my_robot.return_spring", raising=False)
    effects = Effects("effect", {}, group="realsim.effects")
    assert list(effects) == ["return_spring"]
    with pytest.raises(RealsimError, match="return_spring"):
        effects["return_spring"]


@pytest.mark.slow
def test_no_gap_with_the_whole_library(made) -> None:
    found = diagnose(load_case(made(Truth(), seed=100)))
    assert found.verdict == "no_gap"
    assert not found.causes


@pytest.mark.slow
def test_found_among_the_whole_library(made) -> None:
    """By name, or as a named equivalent where the log cannot tell."""
    found = diagnose(load_case(made(Truth(coulomb={"elbow": 0.4}), torque="measured", runs=3)))
    assert found.verdict in ("identified", "ambiguous", "partly_explained")
    assert "coulomb_friction" in {c["effect"] for s in [found.causes, *found.equivalent] for c in s}
    assert found.shrinkage["ci90"][0] > 0
    assert found.causes[0]["joints"] == ["elbow"]
    assert found.causes[0]["parameters"]["friction"]["value"] == pytest.approx(0.4, rel=0.15)


@pytest.mark.slow
def test_outside_the_library_is_unexplained(made) -> None:
    found = diagnose(load_case(made(Truth(ripple={"shoulder": 2.0}), runs=3, span=(2.2, 2.6))))
    assert found.verdict in ("unexplained", "partly_explained")
