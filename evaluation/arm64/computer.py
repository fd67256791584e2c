"""An arm64 Debian in a folder, whose Python qemu runs on this computer: no root, no kernel and no container are needed.

It has what a vehicle's computer has: the Python of the release's image, and the wheels that `requirements.lock` pins
for aarch64, by their hashes. pytest comes with it. Programs that a program starts do not run, since the kernel of this
computer does not know their processor.
"""

import os
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from evaluation import ROOT
from release.image import PYTHON, SUITE
from release.wheels import GLIBC_MINOR

PACKAGES = "python3-minimal,libpython3-stdlib,base-files,zlib1g,libstdc++6,libgcc-s1,umockdev"
"""Debian packages: Python, what wheels link to, and the emulated I2C bus of tests/support/kernel_bus.py."""
TESTS = ("pytest", "pytest-timeout")
"""Python packages of tests: pytest, and what pyproject.toml configures of it."""
PROGRAMS = {"mmdebstrap": "mmdebstrap", "qemu-aarch64": "qemu-user", "gcc": "gcc libc6-dev"}
"""Programs that this needs, and Debian's packages that have them."""
COUNTS_BYTES = 4096
"""Size of the plugin's file: `SIZE` in count.c."""


class Arm64:
    """An emulated computer; programs see the files of this one where it has none of its own.

    Parameters
    ----------
    folder
        Where it is, or is made (a minute).

    Raises
    ------
    FileNotFoundError
        A program is missing; the message names the packages to install.
    """

    def __init__(self, folder: Path) -> None:
        lacking = [package for program, package in PROGRAMS.items() if shutil.which(program) is None]
        if lacking:
            raise FileNotFoundError(f"emulating arm64 needs Debian's packages: apt install {' '.join(lacking)}")
        self._folder = folder.absolute()
        self._debian, self._plugin = self._folder / "debian", self._folder / "count.so"
        made = self._folder / "made"
        if not made.exists():
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder.mkdir(parents=True)
            self._make()
            made.touch()

    def _make(self) -> None:
        options = ["--quiet", "--variant=extract"]
        debian = [f"--architectures=arm64 --include={PACKAGES}".split(), [SUITE, str(self._debian)]]
        subprocess.run(["mmdebstrap", *options, *debian[0], *debian[1]], check=True)
        self._install("packages", "--require-hashes", f"--requirements={ROOT / 'requirements.lock'}")
        self._install("tests", *TESTS)
        version = re.search(r"version (\d+)", _output(["qemu-aarch64", "--version"]))
        assert version is not None
        # qemu 9 changed the interface, and has no plugin of the version before.
        interface = 1 if int(version[1]) < 9 else 2
        flags = ["-O2", "-shared", "-fPIC", f"-DPLUGIN_VERSION={interface}"]
        subprocess.run(["gcc", *flags, "-o", self._plugin, Path(__file__).with_name("count.c")], check=True)

    def _install(self, folder: str, *arguments: str) -> None:
        install = [sys.executable, "-m", "uv", "pip", "install", "--quiet", f"--target={self._folder / folder}"]
        install += [f"--python-version={PYTHON}", f"--python-platform=aarch64-manylinux_2_{GLIBC_MINOR}"]
        subprocess.run([*install, "--only-binary=:all:", *arguments], check=True)

    def command(self, *arguments: str | Path, counts: Path | None = None) -> list[str]:
        """The command that runs Python with these arguments; ``counts`` is where its instructions are counted."""
        plugin = [] if counts is None else ["-plugin", f"{self._plugin},to={counts}"]
        python = self._debian / "usr/bin" / f"python{PYTHON}"
        return ["qemu-aarch64", *plugin, "-L", *map(str, (self._debian, python, *arguments))]

    @property
    def environment(self) -> dict[str, str]:
        """Variables for `command`. Bytecode is kept, as on a vehicle's computer, apart from that of this one."""
        places = (ROOT, ROOT / "sim", self._folder / "packages", self._folder / "tests")
        own = {"PYTHONPATH": os.pathsep.join(map(str, places)), "PYTHONPYCACHEPREFIX": str(self._folder / "bytecode")}
        return {name: os.environ[name] for name in os.environ if not name.startswith("PYTHON")} | own

    def run(self, arguments: Sequence[str | Path], counts: Path | None = None) -> "subprocess.CompletedProcess[str]":
        """Run Python to its end, in the project's folder; what it prints is in the result."""
        command = self.command(*arguments, counts=counts)
        return subprocess.run(command, cwd=ROOT, env=self.environment, capture_output=True, text=True)

    def libraries(self) -> list[Path]:
        """The compiled files of the pinned packages."""
        return sorted((self._folder / "packages").rglob("*.so"))


def instructions(counts: Path) -> int:
    """Instructions that a program has executed so far, by the file that it counts them in."""
    return sum(struct.unpack(f"<{COUNTS_BYTES // 8}Q", counts.read_bytes()))


def _output(command: list[str]) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout
