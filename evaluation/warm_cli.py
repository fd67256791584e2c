"""The commands msp-lab, msp-range and msp-sim without the second or two that each takes to start.

``python -m evaluation.warm_cli`` has imported them once. It reads command lines from standard input, each a JSON
list on a line of its own, runs each in a fork of itself as the command would run, and answers a line: exit code and the
end of its output. It ends with its input.
"""

import json
import os
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module

HEAVY = (
    "msp_lab.characterise.analysis",
    "msp_lab.readings.intake",
    "msp_lab.characterise.model_file",
    "msp_lab.characterise.show",
    "msp_lab.gap.steps",
    "msp_lab.gap.terminal",
)
"""What the commands import late."""
TAIL = 500


def main() -> None:
    """Serve until there is no more to read."""
    from msp_lab.cli import main as msp_lab
    from msp_range.cli import main as msp_range
    from msp_sim.cli import main as msp_sim

    for module in HEAVY:
        import_module(module)
    commands = {"msp-lab": msp_lab, "msp-range": msp_range, "msp-sim": msp_sim}
    for line in sys.stdin:
        argv = json.loads(line)
        with tempfile.TemporaryFile() as output:
            child = os.fork()
            if child == 0:
                os.dup2(output.fileno(), 1)
                os.dup2(output.fileno(), 2)
                sys.argv = argv
                os._exit(_exit_code(commands[argv[0]]))
            _, status = os.waitpid(child, 0)
            output.seek(0)
            text = output.read().decode(errors="replace")
        print(json.dumps([os.waitstatus_to_exitcode(status), text.strip()[-TAIL:]]), flush=True)


def _exit_code(command: Callable[[], None]) -> int:
    try:
        command()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        import traceback

        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
    return 0


if __name__ == "__main__":
    main()
