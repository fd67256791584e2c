"""Corrections of a reading before it is filtered: the speed of sound at the air's temperature."""
