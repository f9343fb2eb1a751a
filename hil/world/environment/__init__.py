"""The orbital environment of the truth: external forces and torques on each body of the robot.

The section `environment` of a scenario switches each effect on. Nothing here uses the flight
software. `hil.world.simulation.simulate_in` simulates the truth in an environment.
"""
