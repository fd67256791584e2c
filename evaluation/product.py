"""The product's commands, run in this process, where what they import stays loaded.

A generator that shares nothing with the product calls it by the names of its commands only.
"""

import io
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module

TAIL = 300
"""Characters of a failed command's output that are kept: its last lines say what was wrong."""


def command(program: str, *arguments: object) -> str:
    """Run a command, such as msp-lab; return what ended it, empty where it succeeded."""
    app = import_module(f"{program.replace('-', '_')}.cli").app
    output = io.StringIO()
    try:
        with redirect_stdout(output), redirect_stderr(output):
            code = app([str(each) for each in arguments], standalone_mode=False)
    except (Exception, SystemExit) as error:
        # Whatever it is, a table of many cases goes on.
        return f"{arguments[0]}: {type(error).__name__}: {error} {output.getvalue()[-TAIL:]}".strip()
    return f"{arguments[0]}: exit code {code}: {output.getvalue()[-TAIL:]}" if code else ""
