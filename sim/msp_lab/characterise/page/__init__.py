"""The page of a characterisation: one HTML file and each picture as PNG.

`write.write_report`: what was found (`msp_lab.characterise.findings`), the readings that it was found in, and the
fitted sensor model enter; ``report.html`` and PNGs leave. A module for each subject takes arrays out of data and
findings, or gives the reason why they are missing, and draws them. Needs the extra ``lab``.
"""
