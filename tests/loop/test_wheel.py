"""What `pip install .` brings: the commands, and every file that they read (tests/peers/test_packages.py flies it)."""

import subprocess
import sys
from pathlib import Path
from shutil import copytree, ignore_patterns
from zipfile import ZipFile

import pytest

from tests.support.shipped import ROOT

SOURCES = ("msp_range", "sim", "configs", "bin", "pyproject.toml", "README.md", "LICENSE")
PIP = [sys.executable, "-m", "pip", "--quiet"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy of the sources as git has them."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        source, target = ROOT / name, folder / "source" / name
        if source.is_dir():
            copytree(source, target, symlinks=True, ignore=ignore_patterns("__pycache__", "*.egg-info"))
        else:
            target.write_bytes(source.read_bytes())
    options = ["--no-index", "--no-deps", "--no-build-isolation", f"--wheel-dir={folder}"]
    subprocess.run([*PIP, "wheel", *options, str(folder / "source")], check=True, timeout=120.0)
    (made,) = folder.glob("*.whl")
    return made


def test_it_holds_every_configuration_file_template_and_command(wheel: Path) -> None:
    held = set(ZipFile(wheel).namelist())
    configs = {f"msp_range/{path.relative_to(ROOT)}" for path in (ROOT / "configs").rglob("*.yaml")}
    sources = [ROOT / "msp_range", *(ROOT / "sim").glob("msp_*")]
    needed = {
        str(path.relative_to(folder.parent))
        for folder in sources
        for path in folder.rglob("*")
        if path.suffix in (".py", ".html", ".typed")
    }
    assert len(configs) > 30
    assert configs | needed <= held
    scripts = {Path(name).name for name in held if ".data/scripts/" in name}
    assert scripts == {path.name for path in (ROOT / "bin").iterdir()}
