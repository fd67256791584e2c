"""What goes into a release's files, and which folder may be emptied for them; without a network."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from release import ROOT, __main__, deb, image
from tests.support.service import missing


@pytest.fixture
def control(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The control files of a package, made of a copy of the sources without wheels."""
    if not shutil.which("dpkg-deb"):
        missing("no dpkg-deb")
    tree, out = tmp_path / "tree", tmp_path / "out"
    out.mkdir()
    for folder in ("configs", "systemd", "release/debian"):
        shutil.copytree(ROOT / folder, tree / folder)
    for name in ("requirements.lock", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    (tree / "release/debian/postinst").write_text("#!/bin/sh\necho that of the tree\n")
    wheel = tmp_path / "msp_range-1.2.3-py3-none-any.whl"
    wheel.write_bytes(bytes(1000))
    monkeypatch.setattr(deb, "download", lambda *_: None)
    package = deb.make_deb(tree, wheel, "aarch64", out)
    subprocess.run(["dpkg-deb", "--control", package, tmp_path / "control"], check=True)
    return tmp_path / "control"


def fields(control: Path) -> dict[str, str]:
    return dict(re.findall(r"^(\S+): (.*)$", (control / "control").read_text(encoding="utf-8"), re.M))


def is_admitted(depends: str, python: str) -> bool:
    """Whether a version of Debian's python3 meets all of a package's requirements of it."""

    def meets(relation: str, version: str) -> bool:
        operator = {">=": "ge", "<<": "lt"}[relation]
        return subprocess.run(["dpkg", "--compare-versions", python, operator, version]).returncode == 0

    groups = [group for group in depends.split(", ") if group.startswith("python3 ")]
    return all(any(meets(*each) for each in re.findall(r"\((\S+) (\S+)\)", group)) for group in groups)


def test_a_package_has_the_scripts_of_the_tree_and_the_room_that_they_need(control: Path) -> None:
    assert "that of the tree" in (control / "postinst").read_text(encoding="utf-8")
    found = fields(control)
    assert found["Version"] == "1.2.3"
    assert int(found["Installed-Size"]) > deb.ENVIRONMENT_KB


def test_a_package_admits_the_pythons_that_it_has_wheels_for(control: Path) -> None:
    depends = fields(control)["Depends"]
    debian = {"3.10": "3.10.6-1", "3.11": "3.11.2-1+b1", "3.12": "3.12.3-0ubuntu2", "3.13": "3.13.5-1"}
    debian |= {"3.14": "3.14.0~rc1-1", "3.15": "3.15.0-1"}
    assert tuple(name for name, version in debian.items() if is_admitted(depends, version)) == deb.DEBIAN_PYTHONS


@pytest.mark.parametrize(
    ("there", "code"), [("etc/systemd/system/msp-range.service", 0), ("opt/msp-range/installed.sha256", 1)]
)
def test_a_package_refuses_what_install_sh_made_and_no_unit_of_the_owner(tmp_path: Path, there: str, code: int) -> None:
    assert "readonly SUMS=$OPT/installed.sha256" in (ROOT / "install.sh").read_text(encoding="utf-8")
    (tmp_path / there).parent.mkdir(parents=True)
    (tmp_path / there).touch()
    script = (ROOT / "release/debian/preinst").read_text(encoding="utf-8")
    script = re.sub(r"(?<= )/(?=etc|opt)", f"{tmp_path}/", script)
    assert subprocess.run(["sh", "-c", script], capture_output=True).returncode == code


def test_only_a_release_is_deleted_for_a_new_one(tmp_path: Path) -> None:
    made = [tmp_path / name for name in ("SHA256SUMS", "msp_range-0.9.0.tar.gz", "msp-range_0.9.0_arm64.deb")]
    for path in made:
        path.touch()
    __main__.empty(tmp_path)
    assert list(tmp_path.iterdir()) == []
    for name in ("letter.txt", "msp-range_folder"):
        for path in made:
            path.touch()
        (tmp_path / name).mkdir()
        with pytest.raises(ValueError, match=name):
            __main__.empty(tmp_path)
        assert all(path.exists() for path in made)
        (tmp_path / name).rmdir()


def test_a_file_that_was_never_added_is_not_committed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(__main__, "ROOT", tmp_path)
    (tmp_path / ".gitignore").write_text("*.log\n")
    identity = ("-c", "user.name=a", "-c", "user.email=a@localhost", "-c", "commit.gpgsign=false")
    for words in (("init", "--quiet"), ("add", "."), (*identity, "commit", "--quiet", "--message=first")):
        __main__.git(*words)
    (tmp_path / "run.log").touch()
    assert __main__.is_committed()
    (tmp_path / "forgotten.py").touch()
    assert not __main__.is_committed()


def test_an_image_has_a_name_that_no_public_registry_has(monkeypatch: pytest.MonkeyPatch) -> None:
    layout = {
        member.name: contents
        for member, contents in image._layout({"architecture": "arm64", "os": "linux"}, [], "1.2.3")
    }
    (manifest,) = json.loads(layout["index.json"])["manifests"]
    names = {manifest["annotations"][f"{key}.name"] for key in ("io.containerd.image", "org.opencontainers.image.ref")}
    assert names == {"localhost/msp-range:1.2.3"}
