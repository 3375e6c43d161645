"""It walks in simulation and not on the robot: contract, delay, physics, camera and terrain of one log, in this order,
on one page, each with the setting to change."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from realsim.core.errors import GapError, RealsimError
from realsim.core.files import output_folder, to_json, write_text
from realsim.gap.answer.brief import brief
from realsim.gap.answer.horizons import only_in_long_replays
from realsim.gap.case.case import Case, load_case
from realsim.gap.checks.contract import check, load_policy, read_steps
from realsim.gap.checks.contract.settings import setting
from realsim.gap.checks.footholds.run import check_camera, check_scene, terrain_under
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects import EFFECTS
from realsim.gap.pipeline import Progress, diagnose
from realsim.gap.verdicts import WORDINGS, GapVerdict
from realsim.report import page
from realsim.report.page import Level


@dataclass(frozen=True)
class Part:
    """The answer to one question about the log."""

    name: str
    """`contract`, `delay`, `physics`, `camera`, or `terrain`."""
    level: Level | None
    """None: not checked, and `finding` says why."""
    finding: str
    settings: dict[str, str] = field(default_factory=dict)
    """Framework -> what to change there; empty where nothing is to be changed."""
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": self.name, "checked": self.level is not None, "level": self.level, "finding": self.finding,
            "settings": self.settings, "notes": list(self.notes),
        }  # fmt: skip


def run_doctor(
    folder: Path,
    out: Path,
    progress: Progress,
    *,
    policy: Path,
    deploy_yaml: Path | None = None,
    scene: Path | None = None,
    config: DiagnoseConfig | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write doctor.json and report.html to `out`; returns what doctor.json holds.

    Args:
        folder: a case (docs/diagnose.md).
        policy: policy.onnx that ran on the robot; `deploy_yaml` its contract where the file has none.
        scene: scene.xml on which it walked, for camera and terrain; the case's own terrain if None.

    Raises:
        GapError: the case or the policy cannot be read. A part that the log does not support is no error: it is shown
            as not checked, with the reason.
    """
    with output_folder(Path(out), overwrite=overwrite, source=Path(folder)) as work:
        case = load_case(Path(folder))
        trained = load_policy(policy, deploy_yaml, case.joint_names)
        progress("contract", 0.0)
        parts = [_contract(case, trained)]
        parts += _physics(case, config or DiagnoseConfig(), progress)
        progress("camera", 0.9)
        parts.append(_camera(case, scene))
        progress("terrain", 0.95)
        parts.append(_terrain(case, scene))
        found = _verdict(parts) | {"parts": [p.as_dict() for p in parts], "policy": policy.name}
        write_text(work / "doctor.json", to_json(found))
        write_text(work / "report.html", _page(found, parts, case.folder.absolute().name))
    return found


def _contract(case: Case, trained: Any) -> Part:
    try:
        found = check(trained, read_steps(case, trained.camera))
    except GapError as error:
        return Part("contract", None, error.render())
    levels: dict[str, Level] = {"kept": "good", "still": "look", "unexplained": "look"}
    words: dict[str, str] = {}
    if found.verdict in ("broken", "ambiguous"):
        kinds = [e["kind"] for e in found.errors] + [o["kind"] for e in found.errors for o in e["or"]]
        words = _settings(dict.fromkeys(kinds))
    return Part("contract", levels.get(found.verdict, "bad"), found.sentence, words, found.notes)


def _physics(case: Case, config: DiagnoseConfig, progress: Progress) -> list[Part]:
    """Delay and physics, by one search: what it names is sorted into both."""
    try:
        found = diagnose(case, config, progress)
    except RealsimError as error:
        return [Part("delay", None, error.render()), Part("physics", None, error.render())]
    result = found.as_dict()
    verdict = GapVerdict(result["verdict"])
    rows = [f"{label}: {text}" for part in brief(result).values() for label, text in part]
    causes = [c for s in (result["causes"], *result["equivalent"]) for c in s]
    delays = list(dict.fromkeys(c["effect"] for c in causes if "delay" in c["parameters"]))
    others = list(dict.fromkeys(c["effect"] for c in causes if "delay" not in c["parameters"]))
    late = "no delay of commands or readings is named" if not delays else result["sentence"]
    level, sentence = WORDINGS[verdict].level, str(result["sentence"])
    chaotic = only_in_long_replays(found.evidence) if verdict is GapVerdict.UNEXPLAINED and not causes else False
    if chaotic:
        level = "good"
        sentence = "predictions over 0.1 to 0.5 s are within noise: replays part because small differences grow"
    elif chaotic is None:
        level = "look"
    if verdict is GapVerdict.IDENTIFIED:
        level = "look"  # something is to be changed
    return [
        Part("delay", "look" if delays else "good", late, _settings(delays)),
        Part("physics", level if others or not delays else "good",
             sentence if others or not delays else "nothing beside the delay is named",
             _settings(others), tuple(rows)),
    ]  # fmt: skip


def _camera(case: Case, scene: Path | None) -> Part:
    try:
        found = check_camera(case, scene)
    except RealsimError as error:
        return Part("camera", None, error.render())
    if found is None:
        return Part("camera", None, "the log has no depth frames (depth_camera in log.json)")
    if not found.named:
        return Part("camera", "good", "where the model has it, on time, and no noisier than it should be")
    return Part("camera", "look", " ".join(found.sentences()), _settings(found.named))


def _terrain(case: Case, scene: Path | None) -> Part:
    try:
        found = check_scene(case, terrain_under(case, scene)).verdict
    except RealsimError as error:
        return Part("terrain", None, error.render())
    corrected = "train on the corrected scene.xml of realsim footholds"
    words = {} if found.level == "good" else dict.fromkeys(FRAMEWORKS, corrected)
    return Part("terrain", found.level, found.headline, words, tuple(found.reasons))


def _settings(kinds: Mapping[str, Any] | list[str]) -> dict[str, str]:
    return {f: "; ".join(dict.fromkeys(setting_of(k, f) for k in kinds)) for f in FRAMEWORKS} if kinds else {}


def _verdict(parts: list[Part]) -> dict[str, Any]:
    wrong = [p for p in parts if p.level not in (None, "good")]
    checked = [p.name for p in parts if p.level is not None]
    level: Level = "good" if not wrong else "bad" if any(p.level == "bad" for p in wrong) else "look"
    if wrong:
        headline = f"Mend first: {wrong[0].name}. {wrong[0].finding}"
    elif checked:
        headline = f"Nothing is wrong with {', '.join(checked)}"
    else:
        level, headline = "look", "Nothing could be checked"
    return {"level": level, "headline": headline}


def _page(found: Mapping[str, Any], parts: list[Part], case: str) -> str:
    body = [page.verdict(found["level"], found["headline"], [])]
    for number, part in enumerate(parts, 1):
        word = page.badge(part.level) if part.level is not None else "not checked"
        rows = [[f, text] for f, text in part.settings.items()]
        body.append(
            page.card(
                f"{number}. {part.name.capitalize()}",
                f"<p>{word} {page.esc(part.finding)}</p>"
                + (page.table(["in", "change"], rows) if rows else "")
                + (page.bullets(part.notes) if part.notes else ""),
                wide=True,
            )
        )
    return page.document(f"Doctor of {case}", f"policy {found['policy']}", "".join(body))


FRAMEWORKS = {"mjlab": "mjlab", "Isaac Lab": "isaaclab", "Unitree": "unitree"}
"""Name for a reader -> name in `contract.settings`."""


def setting_of(kind: str, framework: str) -> str:
    """What to change about a kind of contract error, or about an effect."""
    if kind not in EFFECTS:
        return setting(kind, FRAMEWORKS[framework])
    own = EFFECTS[kind].words.settings
    return own[list(FRAMEWORKS).index(framework)] if own else f"{kind}: as in the patched model.xml of realsim diagnose"
