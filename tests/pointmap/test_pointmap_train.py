"""Training of a tiny network: it learns, goes on where it stopped, shares the work; its file is what realsim reads."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from realsim import feedforward
from realsim.core.errors import RealsimError
from realsim.core.types import Frame, FrameSet, Intrinsics
from realsim.feedforward.config import OnnxConfig, PointsConfig
from realsim.feedforward.onnx import SHIPPED
from training.pointmap import bundle, export, metrics, shipped, state, train
from training.pointmap.layouts import library
from training.pointmap.network import TINY, PointmapNet
from training.pointmap.scenes import Generator

pytestmark = pytest.mark.usefixtures("quick_export")
SMALL = ["--shape", "tiny", "--height", "32", "--width", "48", "--images", "4", "--views", "2", "--samples", "1",
         "--scenes", "4", "--warmup", "2", "--log-every", "1", "--device", "cpu"]  # fmt: skip
CPU = train.Rank(0, 1, torch.device("cpu"))


def run(*more: str) -> state.State:
    torch.set_num_threads(1)
    return train.train(train.parse([*SMALL, *more]), CPU)


def test_a_few_steps_on_one_batch_lower_its_loss() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    net = PointmapNet(TINY)
    batch = Generator(library(4, 1), 1, samples=1).batch(0, 3, 2, (32, 48))
    optimiser = torch.optim.AdamW(net.parameters(), 3e-3)
    values = []
    for k in range(25):
        values.append(float(train._step(net, batch, train.Draw.of(0, k, "cpu"))["loss"]))
        optimiser.step()
    assert np.mean(values[-3:]) < 0.6 * values[0]


def test_training_goes_on_where_it_stopped(tmp_path: Path) -> None:
    whole = run("--out", str(tmp_path / "whole"), "--steps", "3")
    out = tmp_path / "run"
    run("--out", str(out), "--steps", "2")
    resumed = run("--out", str(out), "--steps", "1", "--resume", str(out))
    assert (resumed.step, resumed.views) == (3, 12)
    for (name, a), b in zip(whole.net.state_dict().items(), resumed.net.state_dict().values(), strict=True):
        assert torch.equal(a, b), name
    rows = [json.loads(line) for line in (out / "curve.jsonl").read_text().splitlines()]
    assert [r["step"] for r in rows] == [1, 2, 3]
    assert all(np.isfinite(r["loss"]) for r in rows)


def test_weights_alone_are_enough_to_go_on(tmp_path: Path) -> None:
    state.save(tmp_path, run("--out", str(tmp_path), "--steps", "1"))
    assert not state.load(tmp_path).moments
    run("--out", str(tmp_path), "--steps", "1", "--resume", str(tmp_path))
    rates = [json.loads(line)["lr"] for line in (tmp_path / "curve.jsonl").read_text().splitlines()]
    assert rates[1] == rates[0]  # the learning rate warms up again

    file = state.save(tmp_path, state.load(tmp_path))
    for damaged in (file.read_bytes()[:-100], b"x"):
        file.write_bytes(damaged)
        with pytest.raises(RealsimError, match="cannot be used"):
            state.load(tmp_path)


def test_options_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    for wrong in (
        ["--height", "50"],
        ["--images", "1"],
        ["--shape", "huge"],
        ["--samples", "0"],
        ["--compile", "it"],
    ):
        with pytest.raises(RealsimError):
            run("--out", str(tmp_path), *wrong)


BARE = """
import os, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("scipy", "mujoco", "open3d", "cv2", "tyro", "rich", "yaml", "trimesh"):
            raise ImportError(name)
sys.meta_path.insert(0, Absent())
import torch._dynamo  # an optimiser's first step would
from training.pointmap import evaluate, train
o = train.parse(sys.argv[1:])
other = os.fork()
os.environ["RANK"] = str(int(other == 0))
with train.ranks("cpu") as r:
    s = train.train(o, r)
    size = sum(p.detach().double().abs().sum().item() for p in s.net.parameters())
    (o.out / f"end{os.environ['RANK']}").write_text(f"{s.views} {size}")
sys.exit(os.waitstatus_to_exitcode(os.waitpid(other, 0)[1]) if other else 0)
"""
"""A GPU machine as it comes, torch and numpy; imported once for both processes."""


def test_two_processes_share_the_work_where_only_torch_is_installed(tmp_path: Path) -> None:
    """Each has scenes of its own, and both end with the same network."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    root = str(Path(__file__).resolve().parents[2])
    shared = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "OMP_NUM_THREADS": "1"}
    subprocess.run(
        [sys.executable, "-c", BARE, *SMALL, "--out", str(tmp_path), "--steps", "2", "--cooldown", "9"],
        cwd=root, env={**os.environ, **shared, "PYTHONPATH": root}, timeout=200, check=True,
    )  # fmt: skip
    one, two = ((tmp_path / f"end{rank}").read_text() for rank in range(2))
    assert one == two
    assert one.startswith("16 ")
    assert state.load(tmp_path).step == 2


@pytest.mark.slow
def test_the_exported_file_is_what_realsim_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network after a step, its weights in half precision and in 8 bits; the latter through the backend onnx."""
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    monkeypatch.setattr(bundle, "ROUNDS", 1)  # of a long graph onnxruntime thinks for seconds
    traced: list[tuple[bytes, dict[str, float]]] = []
    trace = export.export

    def once(family: Any, options: Any) -> dict[str, float]:
        """The graph of one network, which precisions differ only in how its weights are stored."""
        if not traced:
            off = trace(family, options)
            traced.append((options.out.read_bytes(), off))
        options.out.write_bytes(traced[0][0])
        return traced[0][1]

    monkeypatch.setattr(export, "export", once)
    net = run("--out", str(tmp_path / "run"), "--steps", "1").net
    batch = Generator(library(4, 1, ("clutter",)), 1, samples=1).batch(0, 1, 3, (48, 64))
    frames = []
    for k in range(3):
        K, image, depth = batch.K[0, k].numpy(), batch.images[0, k].numpy(), batch.depth[0, k].numpy()
        camera = Intrinsics(64, 48, *map(float, (K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
        color = (255 * image.transpose(1, 2, 0)).round().astype(np.uint8)
        frames.append(Frame(f"{k}", camera, lambda z=depth: z, lambda c=color: c))
    capture = FrameSet(tuple(frames), Path("made"), "test")
    sizes = []
    for precision in ("float16", "int8"):
        made = export.write(state.State(net), tmp_path / f"{precision}.onnx", (32, 48), precision)
        sizes.append(made.megabytes)
        for (name, kept), (_, trained) in zip(
            shipped.load(made.path).net.state_dict().items(), net.state_dict().items(), strict=True
        ):
            torch.testing.assert_close(kept, trained, rtol=1e-3, atol=5e-3 * float(trained.abs().max()), msg=name)
    assert sizes[0] > sizes[1]
    config = PointsConfig(backend="onnx", onnx=OnnxConfig(model=made.path, drop_least_sure=0))
    solution = feedforward.solve(capture, config)
    maps = feedforward.pointmaps(capture, solution, config)
    assert len(maps) == 3
    assert maps.load(0).mask.mean() > 0.3
    assert not any("guessed" in w for w in maps.warnings)
    with torch.no_grad():
        small = torch.nn.functional.interpolate(batch.images[0], (32, 48), mode="area")[None]
        K = torch.from_numpy(np.diag([0.75, 2 / 3, 1]).astype(np.float32)) @ batch.K
        K[..., 0, 2], K[..., 1, 2] = (
            (batch.K[..., 0, 2] + 0.5) * 0.75 - 0.5,
            (batch.K[..., 1, 2] + 0.5) * 2 / 3 - 0.5,
        )
        z = net(small, torch.zeros(1, 3, 32, 48), K).log_z.exp().numpy()[0]
    got, there = solution.arrays["depth"], solution.arrays["depth"] > 0
    assert np.median(np.abs(got / z - 1)[there]) < 0.02


def test_the_file_that_ships_is_this_network() -> None:
    """Points, poses and doubt of two views by colour alone: the graph in the file is that of the code beside it."""
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    feeds = {name: values[:, :2] for name, values in export._views((240, 320)).items()}
    with torch.no_grad():
        told = export.Exported(shipped.any_of(SHIPPED).net.eval())(*feeds.values())
    for name, off in export._difference([v.numpy() for v in told], export._outputs(SHIPPED, feeds)).items():
        assert off < 0.02, name  # weights in 8 bits


def test_confidence_is_judged_beside_the_oracle() -> None:
    rng = np.random.default_rng(0)
    error = rng.exponential(1, 20000)
    best = metrics.sparsification(error, -error)
    assert best[0] == best[1] < 0.6
    random = metrics.sparsification(error, rng.random(20000))
    assert abs(random[0] - 1) < 0.05


def test_figures_by_hand() -> None:
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, :3, 3] = [0.5, 0, 0]
    true = T.copy()
    true[1, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    z = np.full((2, 4, 4), 2.0)
    found = metrics.figures(5 * z, z, T, z, true)
    assert found.abs_rel == pytest.approx(0, abs=1e-9)
    assert (found.rotation_deg, found.still_deg, found.direction_deg) == pytest.approx((90, 90, 0), abs=1e-4)
    half = z.copy()
    half[:, :1] = 1.0  # a quarter of the pixels is twice as far as it should be
    assert metrics.figures(z, z, T, half, true).abs_rel == pytest.approx(0.25)
