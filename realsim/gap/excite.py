"""From a case, or its diagnosis on disk, to the folder of an experiment."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from realsim.core.errors import GapError
from realsim.core.files import output_folder, read_json
from realsim.gap.case.case import Case, load_case
from realsim.gap.case.recordings import RECORDED
from realsim.gap.config import DiagnoseConfig, ExciteConfig
from realsim.gap.experiments.choose import Looked, look
from realsim.gap.experiments.proposal import bench_of, described
from realsim.gap.experiments.rivals import Rival, rivals_from
from realsim.gap.experiments.write import write_experiment
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.pipeline import diagnose as diagnosed
from realsim.gap.pipeline import limited
from realsim.gap.provenance import engine
from realsim.gap.simulation.simulate import Simulator

Progress = Callable[[str, float], None]


def excite(
    source: Path,
    out: Path | None,
    config: ExciteConfig | None = None,
    diagnose: DiagnoseConfig | None = None,
    progress: Progress | None = None,
    *,
    case: Path | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Choose the experiment that decides between the rivals of an ambiguous diagnosis, and write it to `out`.

    Args:
        source: a case (it is diagnosed first), or the folder of a diagnosis.
        out: gets experiment.json, commands/ (.csv and .npz), README.md and report.html; nothing is written if None.
        case: the case of a diagnosis, where it is not where it was when it was diagnosed.

    Returns:
        What experiment.json holds; with `out` None, `next_experiment` of the diagnosis, chosen anew.

    Raises:
        GapError: where there is nothing to tell apart, where nothing within the limits tells it, or where the diagnosis
            is of another engine or robot. Nothing is written then.
    """
    config, settings, tick = (
        config or ExciteConfig(),
        diagnose or DiagnoseConfig(),
        progress or (lambda what, share: None),
    )
    source = Path(source)
    if out is None:
        loaded, looked, rivals = _looked(source, case, config, settings, tick)
        return described(looked, rivals)
    recorded = Path(out) / RECORDED
    if recorded.is_dir() and any(recorded.iterdir()):
        raise GapError("the folder holds recordings", file=recorded, hint="choose another --out: they would be lost")
    with output_folder(Path(out), overwrite=overwrite, source=source) as work:
        loaded, looked, rivals = _looked(source, case, config, settings, tick)
        proposal = described(looked, rivals)
        if not looked[0].helps:
            refused = "; ".join(f"{one.name}: {one.refused}" for one in looked if one.refused)
            raise GapError(
                "no experiment is written",
                file=source,
                found=f"{proposal['text']}{': ' if refused else ''}{refused}",
                hint="if the robot bears more than it did in the log: --max-speed, --max-torque" if refused else None,
            )
        return write_experiment(work, loaded, looked, rivals, proposal)


def _looked(
    source: Path, folder: Path | None, config: ExciteConfig, settings: DiagnoseConfig, tick: Progress
) -> tuple[Case, list[Looked], tuple[Rival, ...]]:
    """(case, excitations from best to worst, rivals)."""
    case, entries = _read(source, folder, settings, tick)
    with threadpool_limits(1, user_api="blas"), Simulator(case, settings) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), settings)
        rivals = rivals_from(entries, simulator.context)
        bench = bench_of(simulator.context, comparison.noise, config, settings)
        return case, look(bench, rivals, config.excitations, tick), rivals


def _read(source: Path, folder: Path | None, settings: DiagnoseConfig, tick: Progress) -> tuple[Case, list[Any]]:
    """(case, rivals as in diagnosis.json)."""
    if not (source / "diagnosis.json").is_file():
        case = limited(load_case(source), settings)
        found = diagnosed(case, settings, tick).as_dict()
        return case, _rivals(found, source)
    found = read_json(source / "diagnosis.json")
    if not isinstance(found, Mapping):
        raise GapError("diagnosis.json is not an object", file=source / "diagnosis.json")
    rivals = _rivals(found, source / "diagnosis.json")
    made = (found.get("provenance") or {}).get("engine")
    if made != engine():
        raise GapError(
            "the diagnosis is of another version of realsim",
            file=source / "diagnosis.json",
            expected=f"engine {engine()}",
            found=f"engine {made}",
            hint="diagnose the case again, or give the case itself to realsim excite",
        )
    where = found["next_experiment"].get("case")
    if folder is None and not isinstance(where, str):
        raise GapError("the diagnosis does not say where its case is", file=source, hint="give it: --case CASE")
    try:
        case = load_case(folder or (source / where))
    except GapError as error:
        if folder is not None or (source / where).is_dir():
            raise
        raise GapError(
            "the case is not where it was when it was diagnosed", file=source / where, hint="give it: --case CASE"
        ) from error
    return limited(case, settings), rivals


def _rivals(found: Mapping[str, Any], file: Path) -> list[Any]:
    """What the diagnosis could not tell apart, or why there is nothing."""
    proposal = found.get("next_experiment")
    rivals = proposal.get("rivals") if isinstance(proposal, Mapping) else None
    if not isinstance(rivals, list) or len(rivals) < 2:
        count = 1 + len(found.get("equivalent") or []) if found.get("causes") else 0
        raise GapError(
            "there is nothing to tell apart",
            file=file,
            expected="a diagnosis with at least two sets of causes (verdict ambiguous)",
            found=f"verdict {found.get('verdict')}, {count} set" + "s" * (count != 1),
            hint="diagnose the case with this version of realsim"
            if count > 1
            else "one set of causes needs no experiment: simulate with the patched model.xml of the diagnosis",
        )
    return rivals
