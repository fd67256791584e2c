"""Logs that people have (autopilots, ROS, ground stations, our own recordings) as one dataset of readings."""
