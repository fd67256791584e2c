"""Readings of an ultrasonic range finder, made from sound: an independent witness for the fits and the gap workflow.

Nothing here comes from `msp_range` or `msp_sim`, and no number is shared with them: a ping is a burst of pressure that
spreads, is absorbed, meets a target, comes back into noise, and is found where its envelope crosses a threshold. Out
come columns in the project's CSV form. An import contract keeps the two apart.
"""
