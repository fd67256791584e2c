"""A container image of the bridge: an OCI image layout in a tar file, made without a container engine and its daemon.

Two layers: Debian's Python with the few packages that it cannot do without, extracted by mmdebstrap (no program of the
image runs, so it is made for either processor), and the packages that the lock file pins with this one. Times are the
commit's. The first layer is the same only as long as Debian's archive has the same versions.
"""

import gzip
import hashlib
import json
import os
import re
import subprocess
import sys
import tarfile
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from release.deb import ARCHITECTURES
from release.wheels import GLIBC_MINOR

SUITE, PYTHON = "trixie", "3.13"
"""Debian 13 and its Python."""
PACKAGES = "python3-minimal,libpython3-stdlib,base-files,dash,coreutils"
"""What the commands need: Python, and a shell with readlink and env, by which they start."""
LEFT_OUT = ("./dev/", "./var/", "./etc/apt", "./usr/share/locale/", "./usr/share/man/")
"""Folders of Debian without a use in the image; the licences in /usr/share/doc stay."""
USER = 10001
"""User and group in the image; one that a computer's own users hardly have."""
NAME = "localhost/msp-range"
"""The image's name. With a registry of its own, which is none, no engine looks for it in a public one."""
LIBRARY = "opt/msp-range"
MEDIA = "application/vnd.oci.image"
USERS = f"root:x:0:0::/root:/bin/sh\nmsp-range:x:{USER}:{USER}::/var/lib/msp-range:/bin/sh\n"
Layer = Iterable[tuple[tarfile.TarInfo, bytes]]
"""Files with their contents, which only regular files have."""


def make_image(tree: Path, wheel: Path, machine: str, out: Path) -> None:
    """Make the image for a kind of processor from a tree of sources and the wheel of them."""
    architecture, version = ARCHITECTURES[machine], wheel.name.split("-")[1]
    with TemporaryDirectory() as folder:
        layers = [_tar(_debian(architecture, Path(folder))), _tar(_programs(tree, wheel, machine, Path(folder)))]
    configuration = {
        "architecture": architecture,
        "os": "linux",
        "config": {
            "User": f"{USER}:{USER}",
            "WorkingDir": "/var/lib/msp-range",
            "Env": [
                f"PATH=/{LIBRARY}/bin:/usr/bin:/bin",
                f"PYTHONPATH=/{LIBRARY}",
                # Bytecode is made at a container's first start, and kept for its later ones.
                "PYTHONPYCACHEPREFIX=/var/lib/msp-range/.pycache",
            ],
            "Entrypoint": ["msp-range"],
            "Cmd": ["run", "/etc/msp-range/airframe.yaml", "--log", "json"],
        },
        "rootfs": {"type": "layers", "diff_ids": [f"sha256:{_sha256(layer)}" for layer in layers]},
    }
    path = out / f"msp-range_{version}_{architecture}.oci.tar"
    path.write_bytes(_tar(_layout(configuration, layers, version)))


def _debian(architecture: str, folder: Path) -> Layer:
    """Debian's packages, extracted: the first layer."""
    options = ["--quiet", "--variant=extract", f"--architectures={architecture}", f"--include={PACKAGES}"]
    subprocess.run(["mmdebstrap", *options, SUITE, folder / "debian.tar"], check=True)
    with tarfile.open(folder / "debian.tar") as archive:
        for member in sorted(archive.getmembers(), key=lambda each: each.name):
            if not member.name.startswith(LEFT_OUT):
                contents = archive.extractfile(member) if member.isfile() else None
                yield member, contents.read() if contents else b""


def _programs(tree: Path, wheel: Path, machine: str, folder: Path) -> Layer:
    """The programs and the image's own files: the second layer."""
    root = folder / "root"
    install = [sys.executable, "-m", "uv", "pip", "install", "--quiet", f"--target={root / LIBRARY}"]
    install += [f"--python-version={PYTHON}", f"--python-platform={machine}-manylinux_2_{GLIBC_MINOR}"]
    install += ["--only-binary=:all:", "--link-mode=copy"]
    subprocess.run([*install, "--require-hashes", "--requirements", tree / "requirements.lock"], check=True)
    subprocess.run([*install, "--no-deps", "--no-index", f"--find-links={wheel.parent}", "msp-range"], check=True)
    for name in ("passwd", "group"):
        (root / "etc").mkdir(exist_ok=True)
        (root / "etc" / name).write_text(USERS if name == "passwd" else re.sub(r":\d+::.*", ":", USERS))
    (root / "tmp").mkdir()
    (root / "var/lib/msp-range").mkdir(parents=True)
    for path in sorted(root.rglob("*")):
        name = str(path.relative_to(root))
        # What installers write for themselves names folders of this computer.
        if not re.search(r"\.dist-info/(RECORD|uv_cache\.json)$|msp-range/(bin/(?!msp-range$)|\.lock)", name):
            member = tarfile.TarInfo(name)
            member.type = tarfile.DIRTYPE if path.is_dir() else tarfile.REGTYPE
            member.mode = 0o755 if path.is_dir() or path.parent.name == "bin" else 0o644
            if name == "tmp":
                member.mode = 0o1777
            if name == "var/lib/msp-range":
                member.uid = member.gid = USER
            yield member, path.read_bytes() if path.is_file() else b""


def _layout(configuration: dict[str, Any], layers: list[bytes], version: str) -> Layer:
    """The files of an image layout (OCI image format 1.0): contents named by their SHA-256, and an index."""
    blobs: list[bytes] = []

    def descriptor(kind: str, blob: bytes) -> dict[str, Any]:
        blobs.append(blob)
        return {"mediaType": f"{MEDIA}.{kind}", "digest": f"sha256:{_sha256(blob)}", "size": len(blob)}

    manifest = {
        "schemaVersion": 2,
        "mediaType": f"{MEDIA}.manifest.v1+json",
        "config": descriptor("config.v1+json", json.dumps(configuration).encode()),
        "layers": [descriptor("layer.v1.tar+gzip", gzip.compress(layer, compresslevel=6, mtime=0)) for layer in layers],
    }
    named = descriptor("manifest.v1+json", json.dumps(manifest).encode())
    name = f"{NAME}:{version}"
    named["annotations"] = {"io.containerd.image.name": name, "org.opencontainers.image.ref.name": name}
    named["platform"] = {name: configuration[name] for name in ("architecture", "os")}
    index = {"schemaVersion": 2, "mediaType": f"{MEDIA}.index.v1+json", "manifests": [named]}
    files = {"oci-layout": b'{"imageLayoutVersion": "1.0.0"}', "index.json": json.dumps(index).encode()}
    for name, contents in (files | {f"blobs/sha256/{_sha256(blob)}": blob for blob in blobs}).items():
        yield tarfile.TarInfo(name), contents


def _sha256(contents: bytes) -> str:
    return hashlib.sha256(contents).hexdigest()


def _tar(layer: Layer) -> bytes:
    """A tar file of these files, with the time that SOURCE_DATE_EPOCH has."""
    packed = BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for member, contents in layer:
            member.mtime = int(os.environ["SOURCE_DATE_EPOCH"])
            member.size = len(contents)
            member.pax_headers = {}
            archive.addfile(member, BytesIO(contents))
    return packed.getvalue()
