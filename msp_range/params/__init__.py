"""Parameters that an autopilot needs for an airframe: what, why, and how they get there.

`settings` computes them from an airframe file, `client` reads and sets them over a MAVLink link, and `commands` is what
`msp-range params` does, files of parameters included.
"""
