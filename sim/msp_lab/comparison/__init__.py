"""Findings of a characterisation next to those of a published one, the MB1242 characterization report.

`report` has its numbers, answers and errata, `figures` its pictures by number, `compare` has where the findings agree,
and `write` makes the page. Nothing of the general characterisation depends on this folder.
"""
