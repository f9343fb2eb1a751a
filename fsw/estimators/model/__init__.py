"""Model: the robot, its bodies, and the estimation problem."""
