"""The page of a characterisation: one HTML file and each picture as PNG.

`write_report(findings, data, model, directory)`: what was found (`msp_lab.characterise.findings`), the readings that
it was found in, and the fitted sensor model enter; ``report.html`` and PNGs leave. `draw` makes pictures of plain
arrays, a module for each subject takes those arrays out of data and findings or gives the reason why they are missing,
`write` makes the page. Needs the extra ``lab``.
"""
