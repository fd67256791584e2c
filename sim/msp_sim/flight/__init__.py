"""A flight in the simulator: its scenario, the loopback autopilot, what it leaves behind, and how that is shown."""
