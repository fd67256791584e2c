"""Campaigns: what is to be measured, and collecting it at the bench, in flight and on emulated sensors."""
