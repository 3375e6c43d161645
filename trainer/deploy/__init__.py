"""A policy on a robot: a 50 Hz loop over a small interface, MuJoCo behind it or a real robot (docs/deploy.md).

robot.py     the interface            observer.py   readings -> the policy's inputs
mujoco.py    MuJoCo in the loop       loop.py       read, think, write, on time
"""
