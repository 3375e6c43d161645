"""Fine-tuning perceptive locomotion policies on reconstructed terrain.

    terrain/   where the robot walks: generated families, the curriculum grid, named tests, reconstructed scenes
    robots/    what is trained: default pose, action scale, limits, feet, camera mount
    physics/   one interface, two engines: MuJoCo on the CPU, MuJoCo Warp on the GPU
    rays/      depth images and height probes against a terrain's mesh
    tasks/     observation, reward, termination, reset and randomisation, in torch, the same on both engines
    ppo/       networks, algorithm, checkpoints, data parallelism

Imports run one way: `trainer` imports `realsim`, never the reverse.
"""
