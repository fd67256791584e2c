"""The real bridge with an autopilot's own simulator."""
