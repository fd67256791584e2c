"""Loopback simulator of msp_range: what imitates. Imports nothing, so that the device needs no package."""
