"""Commands that the trainer adds to `realsim` (entry points in the group `realsim.commands`). One file a command."""

SUMMARIES = {
    "pretrain": "a base policy on generated terrain",
    "finetune": "a policy adapted to one scene or several; success before and after",
    "evaluate": "success rate of a policy on a scene, why and where it fails",
    "play": "one trial of a policy as a video",
    "deploy": "a policy in a 50 Hz loop on a robot, MuJoCo in place of the real one",
    "training": "`realsim training report RUN ...`: a page with the curves of training runs, over each other",
}
"""Read by `realsim --help`, which imports nothing else of the trainer."""

EXAMPLES = {
    "pretrain": "realsim pretrain --robot g1 --out base",
    "finetune": "realsim finetune scene --out tuned",
    "evaluate": "realsim evaluate scene --policy tuned/policy.pt",
    "play": "realsim play scene --policy tuned/policy.pt --out trial.mp4",
    "deploy": "realsim deploy tuned/policy.onnx --scene scene",
    "training": "realsim training report base_a base_b --out report.html",
}
"""Shown at the end of each command's help."""

COMMON = {
    "finetune": (
        "--policy", "--out", "--overwrite", "--minutes", "--stop-at-target", "--strategy", "--diagnosis", "--worlds",
        "--device", "--final-trials", "--resume",
    ),
    "pretrain": (
        "--out", "--overwrite", "--robot", "--terrain", "--minutes", "--iterations", "--worlds", "--device",
        "--task-file", "--resume",
    ),
}  # fmt: skip
"""The options that `realsim COMMAND --help` shows; `realsim help COMMAND` shows all."""
