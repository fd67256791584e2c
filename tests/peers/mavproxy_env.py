"""Make ``.venv-mavproxy``: MAVProxy with the few packages that it needs without a screen.

``python tests/peers/mavproxy_env.py`` from an environment that has pip; does nothing where it has been done. MAVProxy
asks for OpenCV, VTK and matplotlib too, for maps and plots, so the packages are named here one by one.
"""

import os
import subprocess
import sys
import venv
from pathlib import Path

REQUIREMENTS = (
    *("MAVProxy==1.8.75", "pymavlink>=2.4.49", "pyserial>=3.5", "defusedxml>=0.7.1"),
    *("pexpect>=4.9", "ptyprocess>=0.7", "psutil>=6.0"),  # of ArduPilot's sim_vehicle.py, which starts MAVProxy
)
FOLDER = Path(__file__).parents[2] / ".venv-mavproxy"
PYTHON = FOLDER / "bin" / "python"
MAVPROXY = FOLDER / "bin" / "mavproxy.py"
_DONE = FOLDER / "installed.txt"


def is_made() -> bool:
    """True where the environment is there and holds what is named here."""
    return _DONE.exists() and _DONE.read_text() == "\n".join(REQUIREMENTS)


def make() -> None:
    """Make it, from the beginning."""
    venv.create(FOLDER, clear=True, symlinks=True)
    pip = [sys.executable, "-m", "pip", "--python", str(PYTHON), "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "install", "--no-deps", "--no-compile", *REQUIREMENTS], check=True)
    # The first start leaves bytecode of what it imports: a tenth of what pip would compile.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([PYTHON, MAVPROXY, "--version"], check=True, env=environment, stdout=subprocess.DEVNULL)
    _DONE.write_text("\n".join(REQUIREMENTS))


if __name__ == "__main__" and not is_made():
    make()
