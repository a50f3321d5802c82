"""The top of the stand-in of LeRobot."""
