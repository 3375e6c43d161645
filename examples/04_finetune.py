"""A policy for one terrain: learnt on flat ground, then fine-tuned where it has to walk.

    python examples/04_finetune.py [SCENE]

SCENE is a folder of `realsim reconstruct`; without one an easy course is generated. A few iterations on the CPU show
the calls and teach next to nothing: walking takes hundreds of them (benchmarks/training/trainer_cpu.py).
"""

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

from trainer.evaluate import EvaluationConfig, Setting, evaluate
from trainer.ppo import checkpoint
from trainer.ppo.config import LoopConfig, NetworkConfig, PPOConfig
from trainer.tasks.parkour import ParkourConfig
from trainer.tasks.parkour.config import DepthConfig, TerminationConfig
from trainer.terrain import flat, generate
from trainer.terrain.scene import load
from trainer.trainers import Scene, TrainConfig, find

work = Path(mkdtemp())
terrain = load(sys.argv[1]) if len(sys.argv) > 1 else generate("boxes", difficulty=0.1, seed=0)
task = ParkourConfig(depth=DepthConfig(use=False), termination=TerminationConfig(seconds=4.0))
config = TrainConfig(
    robot="quadruped",
    device="cpu",
    worlds=16,
    task=task,
    loop=LoopConfig(iterations=2, evaluate_every=0, tensorboard=False),
    ppo=PPOConfig(networks=NetworkConfig(actor=(128, 64), critic=(128, 64))),
)

train = find("ppo")
base = train(Scene((flat(),)), None, config, work / "base")
tuned = train(Scene((terrain,)), base.policy, replace(config, strategy="full"), work / "tuned")

for name, result in (("base", base), ("fine-tuned", tuned)):
    policy, _ = checkpoint.load(result.policy)
    trials = evaluate(policy.act, terrain, EvaluationConfig(trials=4, worlds=4), Setting("quadruped", task=task))
    last = trials.results[0]
    print(f"{name}: {last.successes} of {last.trials} trials reach the goal, {last.covered:.0%} of the way on average")
print("for the robot:", tuned.onnx)
