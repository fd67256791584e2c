"""The page of a characterisation: one HTML file and each picture as PNG.

`write.write_report` makes ``report.html`` and PNGs of what was found (`msp_lab.characterise.findings`), the readings
that it was found in, and the fitted sensor model. A module for each subject takes arrays out of data and findings, or
gives the reason why they are missing, and draws them. Needs the extra ``lab``.
"""
