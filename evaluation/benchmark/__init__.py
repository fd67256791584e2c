"""A benchmark of hidden sensor effects for anybody: frozen tables and models, a scorer, and methods that take part."""
