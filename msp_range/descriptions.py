"""Descriptions of the keys of configuration files, read from the strings below the attributes when needed.

pydantic could read them too (``use_attribute_docstrings``), but for every class at import: 40 ms of each start of the
bridge, which needs them only in error messages.
"""

import ast
import inspect
import itertools
import textwrap
from functools import cache


@cache
def descriptions(section: type) -> dict[str, str]:
    """Descriptions by key, of a class and its base classes; attributes without a string are left out."""
    found: dict[str, str] = {}
    for base in reversed(section.__mro__):
        if base.__module__.split(".")[0] not in ("builtins", "pydantic"):
            found |= _of_class(base)
    return found


def _of_class(section: type) -> dict[str, str]:
    try:
        source = inspect.getsource(section)
    except OSError:  # defined interactively, or installed without source
        return {}
    (definition,) = ast.parse(textwrap.dedent(source)).body
    assert isinstance(definition, ast.ClassDef)
    return {
        attribute.target.id: inspect.cleandoc(below.value.value)
        for attribute, below in itertools.pairwise(definition.body)
        if isinstance(attribute, ast.AnnAssign) and isinstance(attribute.target, ast.Name)
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str)
    }
