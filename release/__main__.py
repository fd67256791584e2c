"""Make all files of a release of the last commit: ``make release`` (docs/releasing.md says what each is for).

The same commit gives the same bytes with the same Python, uv and dpkg: files have the commit's time, and packages are
those of requirements.lock. Not so the images, whose first layer has what Debian's archive has on the day.
"""

import argparse
import gzip
import hashlib
import os
import re
import subprocess
import sys
import tarfile
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

from release import ROOT
from release.deb import make_deb
from release.image import make_image
from release.wheels import MACHINES

FILES = re.compile(r"SHA256SUMS|msp[_-]range[_-].*")
"""Names of a release's files: what may be deleted before a new one is made."""


def git(*words: str) -> bytes:
    """What a git command prints in this clone."""
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True).stdout


def is_committed() -> bool:
    """Whether the last commit has all that is in this clone, apart from what .gitignore names."""
    return not git("status", "--porcelain", "--untracked-files=normal")


def empty(folder: Path) -> None:
    """Make a folder for a release, and delete the files of an earlier one in it.

    Raises
    ------
    ValueError
        It has anything else, such as a home folder that was given by mistake; nothing is deleted.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = sorted(folder.iterdir())
    others = [path.name for path in found if not (path.is_file() and FILES.fullmatch(path.name))]
    if others:
        raise ValueError(f"--out {folder}: it has {others[0]}, which is no file of a release; choose another folder")
    for path in found:
        path.unlink()


def export(folder: Path) -> int:
    """Unpack the last commit's files into a folder; returns the commit's time [s since 1970]."""
    with tarfile.open(fileobj=BytesIO(git("-c", "tar.umask=022", "archive", "HEAD"))) as files:
        files.extractall(folder, filter="tar")
    return int(git("log", "-1", "--format=%ct"))


def make_python(tree: Path, out: Path, time_s: int) -> Path:
    """Make sdist and wheel, with the setuptools of the lock file; returns the wheel's path."""
    build = [sys.executable, "-m", "uv", "build", "--quiet", "--no-create-gitignore", f"--python={sys.executable}"]
    build += ["--require-hashes", f"--build-constraints={tree / 'requirements.lock'}", f"--out-dir={out}"]
    subprocess.run([*build, "--sdist", tree], check=True)
    (sdist,) = out.glob("*.tar.gz")
    same_bytes(sdist, time_s)
    subprocess.run([*build, "--wheel", sdist], check=True)
    (wheel,) = out.glob("*.whl")
    return wheel


def same_bytes(archive: Path, time_s: int) -> None:
    """Write a .tar.gz again, sorted, with one time and no owner: setuptools puts the time of the build into it."""
    packed = BytesIO()
    with tarfile.open(archive) as old, tarfile.open(fileobj=packed, mode="w") as new:
        for member in sorted(old.getmembers(), key=lambda each: each.name):
            member.mtime, member.uid, member.gid, member.uname, member.gname = time_s, 0, 0, "", ""
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            member.pax_headers = {}
            new.addfile(member, old.extractfile(member) if member.isfile() else None)
    archive.write_bytes(gzip.compress(packed.getvalue(), mtime=time_s))


def make_sbom(tree: Path, version: str, out: Path) -> None:
    """Make the list of all packages that the lock file pins, with their hashes: CycloneDX, as JSON."""
    project = tree / "pyproject.toml"
    text = re.sub(r"^dynamic = .*$", f'version = "{version}"', project.read_text(encoding="utf-8"), flags=re.M)
    with TemporaryDirectory() as folder:
        (Path(folder) / "pyproject.toml").write_text(text, encoding="utf-8")
        subprocess.run(
            [
                *(sys.executable, "-W", "ignore", "-m", "cyclonedx_py", "requirements", "--output-reproducible"),
                *("--pyproject", f"{folder}/pyproject.toml", "--output-file", out / f"msp_range-{version}.cdx.json"),
                tree / "requirements.lock",
            ],
            check=True,
        )


def main() -> int:
    """Make them; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m release", description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=ROOT / "build/release", help="folder; an earlier release in it is deleted"
    )
    parser.add_argument("--machine", choices=MACHINES, action="append", help="kind of processor (default: both)")
    parser.add_argument("--no-image", action="store_true", help="without container images, which need root")
    given = parser.parse_args()
    try:
        empty(given.out)
    except (ValueError, OSError) as error:
        print(f"python -m release: {error}", file=sys.stderr)
        return 3
    if not is_committed():
        print("note: changes or new files are not committed, and so not in this release: git status", file=sys.stderr)
    os.umask(0o022)
    with TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        time_s = export(tree)
        os.environ["SOURCE_DATE_EPOCH"] = str(time_s)
        wheel = make_python(tree, given.out, time_s)
        make_sbom(tree, wheel.name.split("-")[1], given.out)
        for machine in given.machine or MACHINES:
            make_deb(tree, wheel, machine, given.out)
            if not given.no_image:
                make_image(tree, wheel, machine, given.out)
    made = sorted(given.out.iterdir())
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in made]
    (given.out / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    for path in made:
        print(f"{path.stat().st_size / 1e6:7.1f} MB  {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
