"""The orbital environment of the truth: what pulls and pushes on the robot, body by body.

Switched on in a scenario by its section `environment`; every part can be on alone. Knows nothing of
the flight software. `wrench.simulate_in` is the truth in an environment.
"""
