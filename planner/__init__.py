"""Planner: joint trajectories that make the fused estimate good, within every limit.

`fsw excite` plans before a flight, the worker of the daemon on a telecommand.
"""
