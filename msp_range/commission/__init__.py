"""`msp-range commission`: step by step from wires to a first flight, each step measured on the vehicle itself.

`samples` holds what was received during a guided motion; `motion` measures places from it; `steps` has one file for
each step, which measures the rest, compares it with the airframe file and proposes changes; `edit` saves them.
"""
