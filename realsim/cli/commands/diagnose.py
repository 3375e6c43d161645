"""`realsim diagnose`: one case, or many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from realsim import gap
from realsim.cli.commands import CommandResult, strict_exit
from realsim.cli.commands.many import run_each
from realsim.core.errors import GapError, RealsimError
from realsim.core.files import refuse_within
from realsim.core.progress import answers_early, note, steps, track
from realsim.gap.case.recordings import is_recording
from realsim.gap.config import DiagnoseConfig
from realsim.gap.verdicts import WORDINGS, GapVerdict
from realsim.jobs import ManyConfig

if TYPE_CHECKING:
    from realsim.gap.checks.contract import Found


def diagnose(
    cases: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CASE ...", help_behavior_hint="")],
    config: DiagnoseConfig,
    out: Path | None = None,
    overwrite: bool = False,
    check: bool = False,
    init: Path | None = None,
    explain: str | None = None,
    model: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    scene: Annotated[Path | None, tyro.conf.arg(metavar="STR")] = None,
    policy: Path | None = None,
    deploy_yaml: Path | None = None,
    since: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None,
    strict: bool = False,
    many: ManyConfig = ManyConfig(),
) -> CommandResult:
    """Say where a robot's logs differ from its simulator, which unmodelled effect causes it, and how much it matters.

    Args:
        cases: a folder with log.json, model.xml and runs/ (.npz or .csv); or several, each gets a folder below --out;
            or one, and new recordings of its robot: runs as .npz or .csv, or folders of `realsim excite`.
        out: where diagnosis.json, report.html and the patched model go (default: diagnosis); with --init, the new case
            (default: case).
        overwrite: replace an output folder that realsim wrote before.
        check: report within seconds whether the log can be used, its peculiarities, and with --policy whether the
            policy was run as it was trained; nothing is written.
        init: instead of a case: an MJCF model, for which the folder of a new case is made.
        explain: instead of a case: describe an effect and what excites it (`all` lists them).
        model: of the robot, where CASE is a recording (MCAP, bag, CSV, ...): the case is written beside --out first.
        scene: scene.xml that the depth frames of the log are compared with (default: the terrain of the case's model).
        policy: policy.onnx that was run: check first whether it was run as it was trained.
        deploy_yaml: the contract of a policy whose ONNX file has none (deploy.yaml of unitree_rl_lab,
            IO_descriptors.yaml of Isaac Lab).
        since: case of an earlier log of the same robot: say what changed since then, too (docs/experiments.md).
        strict: exit with code 3 if the gap stays unexplained (the patched model is then not to be used); a gap that is
            partly explained is no failure.
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
            "no case given",
            expected="realsim diagnose CASE --out DIR, --init MODEL.xml, or --explain EFFECT",
            hint="realsim diagnose CASE --check; realsim log makes a case of a recording",
        )
    if model is None:
        refuse_recording(cases[0])
    elif (cases[0] / "log.json").exists():
        raise RealsimError(
            "--model belongs to a recording: this is a case, which has its own", file=cases[0],
            expected="a recording", found="log.json", hint="leave out --model",
        )  # fmt: skip
    if deploy_yaml is not None and policy is None:
        raise RealsimError(
            "--deploy-yaml is the contract of a policy, and none is given", file=deploy_yaml,
            expected="--policy policy.onnx", found="no --policy", hint="add --policy policy.onnx",
        )  # fmt: skip
    if since is not None:
        refuse_recording(since)
    trained = partial(_contract, policy=policy, deploy_yaml=deploy_yaml) if policy is not None else None
    if check and model is not None and len(cases) == 1:
        with case_for_now(cases[0], model) as made:
            return _checked((made,), config, trained)
    if check:
        return _checked(cases, config, trained)
    out = out or Path("diagnosis")
    recordings: tuple[Path, ...] = ()
    if model is None and len(cases) > 1 and any(is_recording(path) for path in cases[1:]):
        cases, recordings = cases[:1], cases[1:]
    if len(cases) == 1 and many.place == "processes":
        case = cases[0]
        if model is not None:
            case = from_recording(cases[0], model, out.with_name(f"{out.name}_case"), overwrite)
            note(f"{cases[0]} is read as {case}; why: realsim log {cases[0]} --model {model}")
        refuse_within(out, case)
        found = None if trained is None else trained(case)
        if found is not None:
            note(found.sentence)  # minutes before the search ends
        with steps() as tick, answers_early():
            result = gap.run_case(
                case, out, config, tick, overwrite=overwrite, scene=scene, recordings=recordings, since=since
            )
        level = WORDINGS[GapVerdict(result["verdict"])].level
        text = _summary(result, out, config)
        if since is not None:
            text = f"{text}\nsince      {result['since']['sentence']}"
        if found is not None:
            text, result = "\n".join([*_policy(found), text]), result | {"contract": found.as_dict()}
        return CommandResult(text, result, strict_exit({"level": level}, strict), level)
    if since is not None or recordings:
        raise RealsimError(
            "--since and new recordings belong to one case", expected="one CASE", found=f"{len(cases)} cases"
        )
    levels = {verdict.value: wording.level for verdict, wording in WORDINGS.items()}
    return run_each("diagnose", cases, out, many, shows="sentence", levels=levels)


def _checked(cases: tuple[Path, ...], config: DiagnoseConfig, trained: Callable[[Path], Found] | None) -> CommandResult:
    """The health of every log, and of its policy's contract; or why it cannot be used: exit code 1 if one of several
    cannot."""

    def checked(case: Path) -> tuple[list[str], dict[str, Any]]:
        found = gap.check_case(case, config)
        lines = _health(case, found)
        if trained is None:
            return lines, found
        policy = trained(case)
        return _policy(policy) + lines, found | {"contract": policy.as_dict()}

    if len(cases) == 1:
        text, result = checked(cases[0])
        return CommandResult("\n".join(text), result)
    lines: list[str] = []
    items: list[dict[str, Any]] = []
    for case in track(cases, "cases"):
        try:
            text, result = checked(case)
        except RealsimError as error:
            text, result = [f"{case.name}: cannot be used: {error.render()}"], error.as_dict()
        lines += text
        items.append({"name": case.name, **result})
    failed = sum("error" in item for item in items)
    return CommandResult("\n".join(lines), {"items": items, "failed": failed}, 1 if failed else 0)


def _health(case: Path, found: Mapping[str, Any]) -> list[str]:
    warnings = found["health"]["warnings"]
    first = f"{case.name}: {len(found['runs'])} run{'s' * (len(found['runs']) > 1)}, {found['seconds']:.0f} s of log: "
    return [
        first
        + (
            f"can be used, with {len(warnings)} note{'s' * (len(warnings) > 1)}"
            if warnings
            else "can be used, nothing odd"
        ),
        *(f"note    {warning}" for warning in warnings),
    ]


def _policy(found: Found) -> list[str]:
    """The answer, then what to change, each mistake on a line of its own."""
    settings = [f"change  {e['setting']}: {e['text']}" for e in found.errors if e["setting"]]
    return [found.sentence, *settings, *(f"note    {note}" for note in found.notes)]


def _contract(folder: Path, policy: Path, deploy_yaml: Path | None) -> Found:
    """Whether the policy was run as it was trained; checked before the search, which takes minutes."""
    from realsim.gap.checks import contract

    note(f"{policy.name} is replayed on the log of {folder}: seconds")
    case = gap.load_case(folder)
    trained = contract.load_policy(policy, deploy_yaml, case.joint_names)
    try:
        return contract.check(trained, contract.read_steps(case, trained.camera))
    except GapError as error:
        error.file = error.file or str(folder)
        error.found = error.found or _why_missing(folder, str(error.expected).partition(" ")[0])
        raise


def _why_missing(folder: Path, signal: str) -> str | None:
    """What `realsim log` found of an array that a case lacks."""
    from realsim.core.files import read_json

    file = folder / "proposal.json"
    found = read_json(file) if file.is_file() else {}
    lines = found.get("missing", []) if isinstance(found, dict) else []
    return next((f"{line}; realsim log shows all" for line in lines if str(line).startswith(f"{signal}:")), None)


def refuse_recording(path: Path) -> None:
    """A recording has no model yet; a case has. Raises RealsimError for what `realsim log` can read."""
    if (path / "log.json").exists() or not path.exists():
        return
    from realsim.gap.recordings.reading import reader_of

    if reader_of(path) is not None:
        raise RealsimError(
            "this is a recording, not a case",
            file=path,
            expected="a folder with log.json, model.xml and runs/",
            hint=f"realsim log {quote(str(path))} --model robot.xml --out case makes one",
        )


def from_recording(recording: Path, model: Path, case: Path, overwrite: bool = False) -> Path:
    """The case of a recording, written to a folder; see `realsim log`."""
    from realsim.gap import recordings as logs

    target = logs.load_target(model)
    proposal = logs.propose(logs.read(recording), target)
    for wording in logs.write_case(proposal, target, case, overwrite=overwrite, check=gap.load_case):
        note(wording)
    return case


@contextmanager
def case_for_now(recording: Path, model: Path) -> Iterator[Path]:
    """The case of a recording, for as long as it is needed; errors about its files name the recording and the model."""
    with TemporaryDirectory() as temporary:
        case = Path(temporary) / recording.stem
        try:
            yield from_recording(recording, model, case)
        except RealsimError as error:
            error.hint = error.hint and error.hint.replace(str(case / "model.xml"), str(model))
            if error.file is not None and Path(error.file).is_relative_to(temporary):
                error.file = str(recording)
            raise


def _summary(result: Mapping[str, Any], out: Path, config: DiagnoseConfig) -> str:
    """The verdict in a word, then a table of at most a dozen lines; all of it is in diagnosis.json and the report."""
    from realsim.gap.answer.brief import brief

    wording = WORDINGS[GapVerdict(result["verdict"])]
    # The finding itself where it can be acted on; the rest of the sentence is in the rows.
    cut_short = result["statistics"]["cut_short"]
    certain = wording.level == "good" if result["causes"] else cut_short  # what was not searched for is not ruled out
    finding = result["sentence"] if certain else wording.headline
    parts = brief(result)
    rows = [row for part in parts.values() for row in part]
    warnings = result["health"]["warnings"]
    if warnings:
        rows.append(("notes", f"{len(warnings)} about the log, in the report; the first: {warnings[0]}"))
    rows.append(("files", f"{out / 'model.xml'}, {out / ('report.html' if config.report else 'diagnosis.json')}"))
    cut = " (the search was cut short)" if cut_short else ""
    return "\n".join([f"{wording.word}{cut}: {finding}", *(f"  {label:<9}{text}" for label, text in rows)])
