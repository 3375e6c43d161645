"""`realsim diagnose`: one case, or many."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from realsim import gap, logs
from realsim.commands import CommandResult, strict_exit
from realsim.commands.many import run_each
from realsim.errors import RealsimError
from realsim.files import refuse_within
from realsim.gap import contract
from realsim.gap.config import DiagnoseConfig
from realsim.gap.logs.recordings import is_recording
from realsim.progress import note, steps, track


def diagnose(
    cases: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CASE ...", help_behavior_hint="")],
    config: DiagnoseConfig,
    out: Path | None = None,
    overwrite: bool = False,
    check: bool = False,
    init: Path | None = None,
    explain: str | None = None,
    model: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    policy: Path | None = None,
    deploy_yaml: Path | None = None,
    since: Annotated[Path | None, tyro.conf.arg(metavar="CASE")] = None,
    jobs: int = 1,
    ray: str | None = None,
    strict: bool = False,
) -> CommandResult:
    """Say where a robot's logs differ from its simulator, which unmodelled effect causes it, and how much it matters.

    Args:
        cases: a folder with log.json, model.xml and runs/ (.npz or .csv); or several, each gets a folder below --out;
            or one, and new recordings of its robot: runs as .npz or .csv, or folders of `realsim excite`.
        out: where diagnosis.json, report.html and the patched model go (default: diagnosis); with --init, the new case
            (default: case).
        overwrite: replace an output folder that realsim wrote before.
        check: say within seconds whether the log can be used, and what is odd about it; nothing is written.
        init: instead of a case: an MJCF model, for which the folder of a new case is made.
        explain: instead of a case: say what an effect looks like and what excites it (`all` lists them).
        model: of the robot, where CASE is a recording (MCAP, bag, CSV, ...): the case is written beside --out first.
        policy: policy.onnx that was run: is it run as it was trained (docs/logs.md)? Said before the diagnosis.
        deploy_yaml: the contract of a policy whose ONNX file has none (unitree_rl_lab).
        since: case of an earlier log of the same robot: say what changed since then, too (docs/experiments.md).
        jobs: with several cases: how many at a time on this machine.
        ray: with several cases: the address of a Ray cluster that shares this file system.
        strict: exit with code 3 if the gap stays unexplained (the patched model is then not to be used).
    """
    if explain is not None:
        text = gap.explain(explain)
        return CommandResult(text, {"effect": explain, "text": text})
    if init is not None:
        made = gap.start_case(init, out or Path("case"), overwrite=overwrite)
        text = f"case    {made}\nnext    {made / 'README.md'} says what is left to do"
        return CommandResult(text, {"case": str(made)})
    if not cases:
        raise RealsimError(
            "no case given", expected="realsim diagnose CASE --out DIR, --init MODEL.xml, or --explain EFFECT"
        )
    if check:
        return _checked(cases, config)
    out = out or Path("diagnosis")
    recordings: tuple[Path, ...] = ()
    if model is None and len(cases) > 1 and any(is_recording(path) for path in cases[1:]):
        cases, recordings = cases[:1], cases[1:]
    if model is not None:
        cases = tuple(_from_recording(case, model, out, overwrite, len(cases)) for case in cases)
    if len(cases) == 1 and ray is None:
        refuse_within(out, cases[0])
        found = None if policy is None else _contract(cases[0], policy, deploy_yaml)
        with steps() as tick:
            result = gap.run_case(cases[0], out, config, tick, overwrite=overwrite, recordings=recordings, since=since)
        level = LEVELS[str(result["verdict"])]
        text = _summary(result, out, config)
        if since is not None:
            text = f"{text}\nsince      {result['since']['sentence']}"
        if found is not None:
            text, result = f"{found.sentence}\n{text}", result | {"contract": found.as_dict()}
        return CommandResult(text, result, strict_exit({"level": level}, strict), level)
    if since is not None:
        raise RealsimError("--since compares one case with an earlier one", found=f"{len(cases)} cases")
    return run_each("diagnose", cases, out, shows="sentence", jobs=jobs, ray=ray)


def _checked(cases: tuple[Path, ...], config: DiagnoseConfig) -> CommandResult:
    """The health of every log, or why it cannot be used; exit code 1 if one of several cannot."""
    if len(cases) == 1:
        found = gap.check_case(cases[0], config)
        return CommandResult("\n".join(_health(cases[0], found)), found)
    lines: list[str] = []
    items: list[dict[str, Any]] = []
    for case in track(cases, "cases"):
        try:
            found = gap.check_case(case, config)
        except RealsimError as error:
            lines.append(f"{case.name}: cannot be used: {error.render()}")
            items.append({"name": case.name, **error.as_dict()})
        else:
            lines += _health(case, found)
            items.append({"name": case.name, **found})
    failed = sum("error" in item for item in items)
    return CommandResult("\n".join(lines), {"items": items, "failed": failed}, 1 if failed else 0)


def _health(case: Path, found: Mapping[str, Any]) -> list[str]:
    warnings = found["health"]["warnings"]
    first = f"{case.name}: {len(found['runs'])} runs, {found['seconds']:.0f} s of log: "
    return [
        first + (f"can be used, with {len(warnings)} notes" if warnings else "can be used, nothing odd"),
        *(f"note    {warning}" for warning in warnings),
    ]


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
    """The verdict in a word, then what it rests on, a fact a line; the whole sentence is in diagnosis.json."""
    from realsim.gap.answer.sentence import phrase
    from realsim.gap.report.words import WORDS, percent

    verdict, causes = str(result["verdict"]), result["causes"]
    size = result["shrinkage"]
    lines = [f"{WORDS[verdict]}: {HEADLINES[verdict]}"]
    lines += [f"  because  {reason}" for reason in result["statistics"].get("reasons", [])[:2]]
    where = sorted(result["where"], key=lambda entry: -entry["share"])[: 0 if verdict == "no_gap" else 2]
    for entry in where:
        place = entry.get("joint") or entry["signal"]
        lines.append(f"  where    {place}, phase {entry['phase']}: {percent(entry['share'])} of the gap")
    lines += [f"  cause    {phrase(cause)} (probability {cause['probability']:.2f})" for cause in causes]
    if causes:
        low, high = (percent(share) for share in size["ci90"])
        unseen = "" if size.get("unseen", True) else ", which the fit has seen"
        runs = ", ".join(size["runs"])
        lines.append(
            f"  size     {percent(size['fraction'])} of the squared error goes [{low}, {high}] on {runs}{unseen}"
        )
    lines.append(f"  next     {_next(result, out)}")
    lines.append(f"model      {out / 'model.xml'}")
    lines.append(f"report     {out / ('report.html' if config.report else 'diagnosis.json')}")
    lines += [f"note       {warning}" for warning in result["health"]["warnings"]]
    return "\n".join(lines)


def _next(result: Mapping[str, Any], out: Path) -> str:
    """What to do about the verdict: the recording that would tell, where there is one."""
    verdict, sentence = str(result["verdict"]), str(result["sentence"])
    if verdict == "no_gap":
        return "nothing to change in the model; record livelier runs to look closer"
    if verdict == "identified":
        return f"simulate with {out / 'model.xml'}, and check it on a new run"
    asked = result.get("next_experiment")
    if asked and asked.get("excitation"):
        return f"realsim excite {out}: {asked['text']}"
    if asked:
        return str(asked["text"])
    _, record, what = sentence.rpartition("record ")
    return (record + what).rstrip(".") if record else "record more runs that move what differs"


HEADLINES = {
    "no_gap": "the runs show no gap beyond noise and everyday deviations.",
    "identified": "the cause is named below.",
    "ambiguous": "several causes explain these runs as well as each other.",
    "unexplained": "do not use the patched model: no known effect explains the gap.",
}
LEVELS = {"no_gap": "good", "identified": "good", "ambiguous": "look", "unexplained": "bad"}
