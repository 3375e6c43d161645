"""`realsim diagnose`: one case, or many."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from realsim import gap, logs
from realsim.commands import CommandResult
from realsim.commands.many import run_each
from realsim.errors import RealsimError
from realsim.files import refuse_within
from realsim.gap import contract
from realsim.gap.config import DiagnoseConfig
from realsim.progress import note


def diagnose(
    cases: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CASE ...", help_behavior_hint="")],
    config: DiagnoseConfig,
    out: Path = Path("diagnosis"),
    explain: str | None = None,
    model: Path | None = None,
    policy: Path | None = None,
    deploy_yaml: Path | None = None,
    jobs: int = 1,
    ray: str | None = None,
    overwrite: bool = False,
) -> CommandResult:
    """Say where a robot's logs differ from its simulator, which unmodelled effect causes it, and how much it matters.

    Args:
        cases: a folder with log.json, model.xml and runs/ (.npz or .csv); or several, each gets a folder below --out.
        out: where diagnosis.json, report.html and the patched model go.
        explain: instead of a case: say what an effect looks like and what excites it (`all` lists them).
        model: of the robot, where CASE is a recording (MCAP, bag, CSV, ...): the case is written beside --out first.
        policy: policy.onnx that was run: is it run as it was trained (docs/logs.md)? Said before the diagnosis.
        deploy_yaml: the contract of a policy whose ONNX file has none (unitree_rl_lab).
        jobs: with several cases: how many at a time on this machine.
        ray: with several cases: the address of a Ray cluster that shares this file system.
        overwrite: replace an output folder that realsim wrote before.
    """
    if explain is not None:
        text = gap.explain(explain)
        return CommandResult(text, {"effect": explain, "text": text})
    if not cases:
        raise RealsimError("no case given", expected="realsim diagnose CASE --out DIR, or --explain EFFECT")
    if model is not None:
        cases = tuple(_from_recording(case, model, out, overwrite, len(cases)) for case in cases)
    if len(cases) == 1 and ray is None:
        refuse_within(out, cases[0])
        found = None if policy is None else _contract(cases[0], policy, deploy_yaml)
        result = gap.run_case(cases[0], out, config, overwrite=overwrite)
        text = _summary(result, out, config)
        if found is not None:
            text, result = f"{found.sentence}\n{text}", result | {"contract": found.as_dict()}
        return CommandResult(text, result)
    return run_each("diagnose", cases, out, shows="sentence", jobs=jobs, ray=ray)


def _contract(folder: Path, policy: Path, deploy_yaml: Path | None) -> contract.Found:
    """Whether the policy was run as it was trained; checked before the search, which takes minutes."""
    case = gap.load_case(folder)
    steps = contract.read_steps(case)
    return contract.check(contract.load_policy(policy, deploy_yaml, case.joint_names), steps)


def _from_recording(recording: Path, model: Path, out: Path, overwrite: bool, count: int) -> Path:
    """The case of a recording, in a folder beside the output; see `realsim log`."""
    case = out.with_name(f"{out.name}_case" if count == 1 else f"{out.name}_case_{recording.stem}")
    target = logs.load_target(model)
    proposal = logs.propose(logs.read(recording), target)
    logs.write_case(proposal, target, case, overwrite=overwrite)
    note(f"{recording} is read as {case}; why: realsim log {recording} --model {model}")
    return case


def _summary(result: Mapping[str, Any], out: Path, config: DiagnoseConfig) -> str:
    lines = [str(result["sentence"]), f"model   {out / 'model.xml'}"]
    lines.append(f"report  {out / ('report.html' if config.report else 'diagnosis.json')}")
    lines += [f"note    {warning}" for warning in result["health"]["warnings"]]
    return "\n".join(lines)
