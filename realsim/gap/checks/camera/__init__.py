"""Recorded depth against rays in the scene: is the camera late, out of place, or noisier than it should be?

recorded.py   depth frames and their camera, from log.json and the runs
rays.py       what the camera would see of the scene, and of the robot itself
calibrate.py  delay, mount and noise with intervals, and which of them are beyond everyday
"""
