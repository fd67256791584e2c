"""MAVLink companion-computer bridge for ultrasonic range finders: what flies."""

__version__ = "0.1.0"
