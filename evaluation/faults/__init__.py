"""The fault campaign: simulated flights with faults, flown by the real bridge and judged by what an autopilot receives.

`python -m evaluation faults --help`; docs/faults.md says what is flown and how it is judged.
"""
