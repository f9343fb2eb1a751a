"""World: the true robot, its motion, environment and sensors."""
