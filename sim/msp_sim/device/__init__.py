"""Emulated sensors and their bus. Imports nothing, so that the device needs no package."""
