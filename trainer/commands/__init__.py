"""Commands that the trainer adds to `realsim` (entry points in the group `realsim.commands`). One file a command."""

from realsim.cli.command import Command

_GROUP = "Policies"
_TAKES = {"scene": ("scene",), "scenes": ("scene",)}
"""Trials need a start and a goal, which `realsim contact` does not make."""
COMMANDS = {
    "pretrain": Command(
        "",
        "a base policy on generated terrain",
        "realsim pretrain --robot g1 --out base",
        _GROUP,
        "train",
        (
            "--out", "--overwrite", "--robot", "--terrain", "--minutes", "--iterations", "--worlds", "--device",
            "--task-file", "--resume",
        ),
    ),
    "finetune": Command(
        "",
        "a policy adapted to one scene or several; success before and after",
        "realsim finetune scene --out tuned",
        _GROUP,
        "train",
        (
            "--policy", "--out", "--overwrite", "--minutes", "--stop-at-target", "--strategy", "--diagnosis",
            "--worlds", "--device", "--final-trials", "--resume",
        ),
        takes=_TAKES,
    ),
    "evaluate": Command(
        "",
        "success rate of a policy on a scene, why and where it fails",
        "realsim evaluate scene --policy tuned/policy.pt",
        _GROUP,
        "train",
        takes=_TAKES,
    ),
    "play": Command(
        "",
        "one trial of a policy as a video",
        "realsim play scene --policy tuned/policy.pt --out trial.mp4",
        _GROUP,
        "train",
        takes=_TAKES,
    ),
    "deploy": Command(
        "",
        "a policy in a 50 Hz loop on a robot, MuJoCo in place of the real one",
        "realsim deploy tuned/policy.onnx --scene scene",
        _GROUP,
        "train",
        takes={"policy": ("network",)},
    ),
    "close": Command(
        "",
        "from a deployment's log to a policy for the robot as it is: contract, diagnosis, fine-tuning, one page",
        "realsim close case --policy tuned/policy.pt --scene scene",
        _GROUP,
        "train",
        ("--policy", "--scene", "--out", "--effects", "--minutes", "--iterations", "--worlds", "--device"),
    ),
    "robot": Command(
        "",
        "a robot of your own: `new` from its model, `check` before it is trained",
        "realsim robot new mydog.xml",
        _GROUP,
        "train",
    ),
    "training": Command(
        "",
        "`realsim training report RUN ...`: a page with the curves of training runs, over each other",
        "realsim training report base_a base_b --out report.html",
        _GROUP,
    ),
}  # fmt: skip
"""Read by `realsim --help`, which imports nothing else of the trainer."""
