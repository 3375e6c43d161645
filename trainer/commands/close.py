"""`realsim close`: from the log of a deployment to a policy for the robot as it is."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.files import read_json, to_json, write_text
from realsim.core.progress import note
from trainer.errors import TrainerError
from trainer.trainers import TrainConfig

STATE = "close.json"


def close(
    case: Annotated[Path, tyro.conf.Positional],
    config: TrainConfig,
    policy: Path,
    scene: str,
    out: Path = Path("closed"),
    effects: tuple[str, ...] = (),
    final_trials: int = 1000,
    task_file: Path | None = None,
) -> CommandResult:
    """Close the loop: contract, diagnosis, fine-tuning in the patched simulator, success there before and after.

    Every step leaves its result in --out and is not done again: the same command goes on where it was interrupted.

    Args:
        case: what `realsim deploy --log` wrote, several runs of it.
        policy: the policy (.pt) that was deployed.
        scene: where it was, as for `realsim finetune`.
        out: folder for everything, with report.html.
        effects: that the diagnosis considers; all if not given.
        final_trials: trials before and after, each in the patched simulator.
        task_file: JSON with differences from the paper's task; that of the base that ships goes with it.
    """
    steps = _Steps(out, {"case": str(case), "policy": str(policy), "scene": scene, "effects": list(effects)})
    contract = steps.do("contract", "is this the policy's own run?", lambda: _contract(case))
    found: dict[str, Any] = {}
    if contract["kept"]:
        found = steps.do("diagnosis", "what differs from the simulator", lambda: _diagnosed(case, out, effects))
    tuned: dict[str, Any] = {}
    if found.get("trained_for"):
        tuned = steps.do(
            "training",
            "fine-tuning for the robot as it is",
            lambda: _tuned(config, policy, scene, out, final_trials, task_file),
        )
    lines = _lines(contract, found, tuned)
    write_text(out / "report.html", _page(case, lines, contract, found, tuned))
    text = [f"{name:<14} {line}" for name, line in lines] + [f"{'report':<14} {out / 'report.html'}"]
    return CommandResult("\n".join(text), {"contract": contract, "diagnosis": found, "training": tuned})


class _Steps:
    """Results of the steps that are done, in the folder."""

    def __init__(self, out: Path, options: dict[str, Any]) -> None:
        self.file = out / STATE
        known = read_json(self.file) if self.file.is_file() else {}
        if not isinstance(known, dict):
            raise TrainerError("the folder's state is damaged", file=self.file, hint="choose another --out")
        if known.get("options", options) != options:
            raise TrainerError(
                "the folder belongs to another loop", file=self.file, expected=str(known["options"]), found=str(options)
            )
        if not known and out.is_dir() and any(out.iterdir()):
            raise TrainerError("the folder holds something else", file=out, hint="choose another --out")
        self.results: dict[str, Any] = known | {"options": options}

    def do(self, name: str, what: str, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        if name not in self.results:
            note(f"{name}: {what}")
            self.results[name] = work()
            write_text(self.file, to_json(self.results))
        return dict(self.results[name])


def _contract(case: Path) -> dict[str, Any]:
    """The fit of `realsim diagnose --policy`; a log that cannot tell contradicts nothing."""
    from realsim.gap.case.case import load_case
    from realsim.gap.checks.contract import check, load_policy, read_steps

    loaded = load_case(case)
    trained = load_policy(case / "policy.onnx", joints=loaded.joint_names)
    steps = read_steps(loaded, trained.camera)
    found = check(trained, steps)
    return {
        "kept": found.verdict in ("kept", "still"),
        "lines": [found.sentence, *(f"{e['text']}: {e['setting']}" for e in found.errors if e["setting"])],
        "off": {e["text"]: e["left"] for e in found.errors},
        "steps": sum(len(run.time) for run in steps.runs),
    }


def _diagnosed(case: Path, out: Path, effects: tuple[str, ...]) -> dict[str, Any]:
    import realsim as rs
    from trainer.tasks.parkour.gap import TAKEN

    found = rs.diagnose(case, out / "diagnosis", rs.DiagnoseConfig(effects=effects), overwrite=True)
    return {
        "verdict": str(found.verdict.value),
        "sentence": found.sentence,
        "causes": [str(c) for c in found.causes],
        "trained_for": found.verdict.value in TAKEN,
    }


def _tuned(
    config: TrainConfig, policy: Path, scene: str, out: Path, final_trials: int, task_file: Path | None
) -> dict[str, Any]:
    from trainer.commands.common import load_policy
    from trainer.commands.finetune import finetune
    from trainer.policies import TASKS

    folder = out / "tuned"
    last = folder / "policy.pt"
    config = replace(config, diagnosis=out / "diagnosis", resume=last if last.is_file() else None)
    task_file = task_file or TASKS.get(load_policy(policy).robot)
    data = finetune((scene,), config, policy, out=folder, task_file=task_file, final_trials=final_trials).data
    return {"policy": str(last)} | {k: data[k] for k in ("before", "after", "verdict")} | {"result": data["result"]}


def _lines(contract: dict[str, Any], found: dict[str, Any], tuned: dict[str, Any]) -> list[tuple[str, str]]:
    lines = [("contract", line) for line in contract["lines"]]
    if not contract["kept"]:
        return [*lines, ("stopped", "mend the deployment first: a diagnosis would blame the robot for it")]
    lines += [("diagnosis", found["sentence"]), *(("cause", c) for c in found["causes"])]
    if found["verdict"] == "no_gap":
        return [*lines, ("nothing to do", "the robot moves as the simulator does: its policy stays as it is")]
    if not found["trained_for"]:
        return [*lines, ("stopped", f"the verdict {found['verdict']} names nothing that a policy can be trained for")]
    for name in ("before", "after"):
        if tuned.get(name):
            lines.append((name, f"{tuned[name]['success']:.1%} in the patched simulator"))
    verdict = tuned.get("verdict")
    lines.append(("delivered", verdict["text"] if verdict else f"{tuned['policy']}, without a test"))
    return lines


def _page(
    case: Path,
    lines: list[tuple[str, str]],
    contract: dict[str, Any],
    found: dict[str, Any],
    tuned: dict[str, Any],
) -> str:
    from realsim.report import page

    well = found.get("verdict") == "no_gap" or bool(tuned.get("verdict") and tuned["verdict"]["better"])
    level: page.Level = "good" if well else ("bad" if not contract["kept"] else "look")
    last = lines[-1]
    parts = [
        page.verdict(level, f"{last[0]}: {last[1]}", [f"{name}: {text}" for name, text in lines[:-1]]),
        page.card("Contract", page.bullets(contract["lines"])),
    ]
    if found:
        body = page.bullets([found["sentence"], *found["causes"]])
        parts.append(page.card("Diagnosis", body + page.links([("diagnosis/report.html", "the whole diagnosis")])))
    if tuned:
        rows = [
            [r["terrain"], name, f"{r['rate']:.1%}", f"{r['interval'][0]:.1%} to {r['interval'][1]:.1%}"]
            for name in ("before", "after")
            if tuned.get(name)
            for r in tuned[name]["terrains"]
        ]
        parts.append(page.card("Success in the patched simulator", page.table(["terrain", "", "rate", "95 %"], rows)))
        if tuned.get("verdict"):
            failures = [*tuned["verdict"]["failures"], *tuned["verdict"]["advice"]]
            parts.append(page.card("Where it fails, and what to try", page.bullets(failures)))
    return page.document("The loop, closed", str(case), "".join(parts))
