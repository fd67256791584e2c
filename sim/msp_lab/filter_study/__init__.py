"""The report's filter study (chapter 5): nine filters, three scenarios, many seeds, and what explains its rows."""
