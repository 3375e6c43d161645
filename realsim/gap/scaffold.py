"""A new case from a model: log.json filled in as far as the model says, and a place for the runs."""

from pathlib import Path

from realsim.core.errors import GapError
from realsim.core.files import MARKS, inside, output_folder, read_bytes, to_json, write_bytes, write_text
from realsim.gap.answer.patch import asset_files
from realsim.gap.case.case import load_model
from realsim.gap.recordings.model import load_target

TO_DO = """# What is left to do

1. Check log.json: `command_kind` (position, velocity or torque), `base`, `torque_kind` (none, measured or
   current_times_constant), `imu_site`, `contact_bodies`. The order of the names is the order of the columns.
2. Put one file per run into runs/: `.npz` with the arrays below, or `.csv` with a header. Record five runs or more,
   three to ten seconds each, with slow and fast motion and reversals; one command twice.
3. `realsim diagnose {folder} --check` says within seconds whether the log can be used.
4. `realsim diagnose {folder} --out diagnosis`

| array | shape | unit |
|---|---|---|
| time | (T,) | s |
| command | (T, {nu}) | as log.json's command_kind |
{signals}| imu_gyro, imu_acc | (T, 3) | rad/s, m/s^2 with gravity; optional, at imu_site |

In .csv files the columns are an array's name and whose it is: `{first}`.
Other names and units go into columns.json. All of it is explained in docs/diagnose.md of realsim.
"""
JOINTS = """| joint_pos | (T, {nj}) | rad (m for slides) |
| joint_vel, joint_torque | (T, {nj}) | rad/s, N m; optional |
"""
BASE = "| base_pos, base_quat | (T, 3), (T, 4) | m, w x y z{optional} |\n"


def start_case(model_xml: Path, out: Path, *, overwrite: bool = False) -> Path:
    """Make a case folder for a robot's model: model.xml with its files, log.json, runs/ and README.md.

    Args:
        model_xml: MJCF of the robot as it is simulated, servos and ground included.
        out: the new folder.
        overwrite: replace such a folder without runs, a diagnosis or a scene there; one with anything else never.

    Returns:
        `out`.

    Raises:
        GapError: the model cannot be read, or has joints and none with an actuator.
    """
    import mujoco

    if not Path(model_xml).is_file():
        raise GapError("no such model", file=model_xml, expected="an MJCF file")
    spec, model, text = load_model(Path(model_xml))
    if "<include" in text or "<model" in text:  # of several files: as one
        whole = mujoco.MjSpec.from_file(str(model_xml))
        whole.compile()
        text = whole.to_xml()
    target = load_target(Path(model_xml))
    if not all(target.actuators):
        expected = "names, by which a log refers to it"
        raise GapError("an actuator of the model has no name", file=model_xml, expected=expected)
    whole = not target.joints  # a body that flies or rolls as a whole
    if not (whole or any(target.driven)):
        raise GapError(
            "the model has no driven joint",
            file=model_xml,
            expected="hinge or slide joints with actuators",
            found=f"{model.njnt} joints, {model.nu} actuators",
        )
    log = {
        "joint_names": list(target.joints),
        "actuator_names": list(target.actuators),
        "command_kind": target.command_kind,
        "command_hold": "zoh",
        "base": "floating" if target.floating else "fixed",
        "torque_kind": "none",
        "imu_site": target.imu_site or None,
        "contact_bodies": [],
        "notes": f"made from {Path(model_xml).name}; see README.md",
    }
    first = f"time,command_{target.actuators[0]},{'base_pos_x' if whole else f'joint_pos_{target.joints[0]}'}"
    signals = "" if whole else JOINTS.format(nj=len(target.joints))
    signals += BASE.format(optional="" if whole else "; optional") if target.floating else ""
    marks = ("README.md", *MARKS) if _without_runs(Path(out)) else MARKS
    with output_folder(out, overwrite=overwrite, source=Path(model_xml), marks=marks) as folder:
        write_text(folder / "model.xml", text)
        for name in asset_files(spec):
            write_bytes(inside(folder, name), read_bytes(inside(Path(model_xml).parent, name)))
        write_text(folder / "log.json", to_json(log))
        write_text(folder / "README.md", TO_DO.format(folder=out, nu=model.nu, signals=signals, first=first))
        (folder / "runs").mkdir()
    return Path(out)


def _without_runs(folder: Path) -> bool:
    """Whether this is a folder that `start_case` made, and nothing was recorded into it."""
    readme, runs = folder / "README.md", folder / "runs"
    ours = readme.is_file() and read_bytes(readme).startswith(TO_DO[:24].encode())
    return ours and runs.is_dir() and not any(runs.iterdir())
