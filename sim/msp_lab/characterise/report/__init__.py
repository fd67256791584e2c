"""The report of a characterisation: one HTML page and each picture as PNG.

`write_report(findings, data, model, directory)`: what was found (`msp_lab.characterise.findings`), the readings that
it was found in, and the fitted sensor model enter; ``report.html`` and PNGs leave. `draw` makes pictures of plain
arrays, `gather` takes those arrays out of data and findings or says why they are not there, `write` makes the page.
Needs the extra ``lab``.
"""

from msp_lab.characterise.report.write import write_report

__all__ = ["write_report"]
