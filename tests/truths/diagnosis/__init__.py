"""A maker of robot logs whose cause is known, kept apart from the diagnosis that must find it.

It shares no code with `realsim.gap`: its own servo loop, friction laws, delays, gear play and sensors, on another time
step, integrator and friction cone than the nominal model. Small deviations that are not a gap are always on.

    robots.py   nominal models: pendulum, two-link arm, six-joint arm, quadruped, G1
    motions.py  commands that a careful operator would record
    truth.py    everything that the true robot does otherwise than its model, as plain numbers
    plant.py    the true robot: physics, drives, sensors
    causes.py   named causes, causes outside the library, and sets that no log can tell apart
    cases.py    draws cases by stratum, writes logs in the contract's form and labels elsewhere
"""
