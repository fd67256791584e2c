"""A second generator of readings with hidden effects, written without sight of the first one or of the product's model.

It draws readings from a statistical model (`density`, `sample`), while `evaluation.blind` stages waveforms.
`generator.case` makes a table with a known truth and a bench table of the same sensor; `workflow` runs `msp-lab` on
both, and `score` compares what it names with the truth. README.md has the results.
"""
