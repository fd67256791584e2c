"""`msp-range commission`: step by step from wires to a first flight, each step measured on the vehicle itself.

`samples` holds what was received during a guided motion; `cover`, `still`, `motion` and `look` are pure functions that
measure from it which sensor is which, distances, places and directions; `steps` has one file for each step, which
compares what was measured with the airframe file and proposes changes; `edit` saves them.
"""
