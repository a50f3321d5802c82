"""Top-level module of the stand-in for LeRobot."""
