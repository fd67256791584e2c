"""Blind pairs for `msp-lab design`: contexts in which two effects look alike, and the session that tells them apart."""
