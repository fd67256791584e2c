"""The wheels that the lock file pins for a Python and a kind of processor, downloaded and checked by their hashes.

`requirements.lock` pins what an installation on a vehicle's computer needs, and setuptools, which builds the package
itself; ``make lock`` renews it. pip evaluates a line's marker for the Python that it runs in, so `pins` does it for
the Python that the wheels are for.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import NamedTemporaryFile

from packaging.requirements import Requirement

PYTHONS = ("3.11", "3.12", "3.13")
"""Those of Debian 12, Ubuntu 24.04 and Debian 13."""
MACHINES = ("x86_64", "aarch64")
GLIBC_MINOR = 36
"""Debian 12 has glibc 2.36: wheels for a later one do not load there."""


def pins(lock: str, python: str, machine: str) -> list[str]:
    """Requirements of a lock file's text that one Python and kind of processor need, with their hashes.

    Examples
    --------
    >>> pins("old==1 ; python_full_version < '3.12' --hash=a\\nnew==2 --hash=b --hash=c\\n", "3.13", "x86_64")
    ['new==2 --hash=b --hash=c']
    """
    environment = {
        "python_version": python,
        "python_full_version": f"{python}.0",
        "implementation_name": "cpython",
        "platform_python_implementation": "CPython",
        "platform_machine": machine,
        "platform_system": "Linux",
        "sys_platform": "linux",
        "os_name": "posix",
    }
    found = []
    for line in lock.replace("\\\n", "").splitlines():
        if line and line[0] not in "# ":
            requirement, *hashes = line.split(" --hash=")
            parsed = Requirement(requirement)
            if parsed.marker is None or parsed.marker.evaluate(environment):
                found.append(" --hash=".join([f"{parsed.name}{parsed.specifier}", *(each.strip() for each in hashes)]))
    return found


def download(lock: Path, python: str, machine: str, folder: Path) -> None:
    """Put the wheels into a folder.

    Raises
    ------
    RuntimeError
        A package has no wheel for this Python and processor, or one whose hash the lock does not have.
    """
    tags = ["manylinux2014", *(f"manylinux_2_{minor}" for minor in range(17, GLIBC_MINOR + 1))]
    with NamedTemporaryFile("w", suffix=".txt") as file:
        file.write("\n".join(pins(lock.read_text(encoding="utf-8"), python, machine)))
        file.flush()
        done = subprocess.run(
            [
                *(sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"),
                *("--require-hashes", f"--requirement={file.name}", f"--dest={folder}"),
                *("--implementation=cp", f"--python-version={python}"),
                *(f"--platform={tag}_{machine}" for tag in tags),
            ],
            capture_output=True,
            text=True,
        )
    if done.returncode != 0:
        raise RuntimeError(f"wheels for Python {python} on {machine}: {done.stderr.strip()[-2000:]}")
