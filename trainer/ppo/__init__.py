"""A thin PPO, readable top to bottom, and four ways to fine-tune.

config.py       what can be chosen
networks.py     depth encoder, actor, critic        gaussian.py    the three formulas of the action distribution
normaliser.py   running observation normalisation   storage.py     rollout, depth frames kept once, advantages
algorithm.py    the update                          amp.py         style prior; motion.py makes its reference
symmetry.py     left-right symmetry by samples      strategies.py  what fine-tuning may change
policy.py       a policy with its layout            checkpoint.py  to and from a file
distributed.py  torchrun                            runner.py      one iteration; loop.py all of them
export.py       ONNX with the layout in its metadata
"""
