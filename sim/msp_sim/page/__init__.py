"""Pages and pictures of what was measured: one look for every report that this project writes.

`style` makes figures and turns them into PNG, `page` puts them into one self-contained HTML file. Neither computes
nor judges anything. Needs the extra ``lab`` (matplotlib, jinja2), so nothing that flies imports it.
"""
