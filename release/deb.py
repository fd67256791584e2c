"""The Debian package: all wheels that requirements.lock pins, files of systemd/ as install.sh has them, and scripts.

The package's script `debian/postinst` makes the environment from these wheels when it is installed, so the same package
serves Debian 12 and 13, whose Pythons differ, without a network.
"""

import re
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from release.wheels import download

ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}
"""Debian's names of the kinds of processor."""
DEBIAN_PYTHONS = ("3.11", "3.13")
"""Those of Debian 12 and 13; each one more adds 16 MB to the package. `debian/control` admits no other one."""
ENVIRONMENT_KB = 270_000
"""Size of the environment that `debian/postinst` makes [kB]. It is added to that of the package's files, so that apt
shows what the disk needs before it installs. Measured with 0.9.0 on Debian 12 and 13: 354 MB in /opt/msp-range less
84 MB of wheels. An upgrade needs as much again while both environments exist, for which a package has no field."""


def make_deb(tree: Path, wheel: Path, machine: str, out: Path) -> Path:
    """Make the package for a kind of processor from a tree of sources and the wheel of them; returns its path."""
    version = wheel.name.split("-")[1]
    with TemporaryDirectory() as folder:
        root = Path(folder)
        opt = root / "opt/msp-range"
        for python in DEBIAN_PYTHONS:
            download(tree / "requirements.lock", python, machine, opt / "wheels")
        sensors = {path: f"etc/msp-range/sensors/{path.name}" for path in (tree / "configs/sensors").glob("*.yaml")}
        copies = sensors | {
            wheel: f"opt/msp-range/wheels/{wheel.name}",
            **{lock: f"opt/msp-range/{lock.name}" for lock in tree.glob("requirements*.lock")},
            tree / "LICENSE": "usr/share/doc/msp-range/copyright",
            **{unit: f"usr/lib/systemd/system/{unit.name}" for unit in (tree / "systemd").glob("*.service")},
            tree / "systemd/msp-range.rules": "usr/lib/udev/rules.d/70-msp-range.rules",
            tree / "systemd/msp-range.modules": "usr/lib/modules-load.d/msp-range.conf",
        }
        for source, place in copies.items():
            (root / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, root / place)
        (root / "usr/bin").mkdir()
        (root / "usr/bin/msp-range").symlink_to("/opt/msp-range/venv/bin/msp-range")
        _write_control(tree, root, version, ARCHITECTURES[machine])
        package = out / f"msp-range_{version}_{ARCHITECTURES[machine]}.deb"
        # Wheels are compressed already. dpkg-deb sorts the files, and takes times after SOURCE_DATE_EPOCH for that.
        subprocess.run(["dpkg-deb", "--root-owner-group", "-Zgzip", "-z1", "--build", root, package], check=True)
    return package


def _write_control(tree: Path, root: Path, version: str, architecture: str) -> None:
    """Write the package's description, its scripts and the list of its configuration files."""
    kilobytes = sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) // 1024 + ENVIRONMENT_KB
    values = {
        "version": version,
        "architecture": architecture,
        "kilobytes": str(kilobytes),
        "pythons": " ".join(DEBIAN_PYTHONS),
    }
    control = root / "DEBIAN"
    control.mkdir()
    for path in (tree / "release/debian").iterdir():
        text = re.sub(r"@(\w+)@", lambda match: values[match[1]], path.read_text(encoding="utf-8"))
        (control / path.name).write_text(text, encoding="utf-8")
    configuration = sorted(f"/{path.relative_to(root)}\n" for path in (root / "etc").rglob("*.yaml"))
    (control / "conffiles").write_text("".join(configuration), encoding="utf-8")
    for path in (root, *root.rglob("*")):
        if not path.is_symlink():
            is_script = path.parent == control and path.read_text(encoding="utf-8").startswith("#!")
            path.chmod(0o755 if path.is_dir() or is_script else 0o644)
