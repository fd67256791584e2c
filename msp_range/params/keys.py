"""What `msp-range sign` does: make a key for MAVLink signing, and give it to the autopilot."""

import hashlib
import os
import pwd
import secrets
import shutil
from contextlib import suppress
from pathlib import Path

from msp_range.clock import Clock
from msp_range.config import Airframe
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.signing import KEY_BYTES, PX4_SIGNS_NOT, Signing, read_key, signing_of
from msp_range.params.client import ParameterClient
from msp_range.params.commands import connect
from msp_range.state_folder import SERVICE_USER
from msp_range.yaml_file import ConfigError

TAKEN_S = 5.0
"""How long to wait for the autopilot's first signed message [s]: its heartbeat comes once a second."""


def key_file(airframe: Airframe) -> Path:
    """Path of the file with the airframe's key.

    Raises
    ------
    ConfigError
        The airframe file does not say it.
    """
    if airframe.link.signing_key is None:
        raise ConfigError("link.signing_key is missing; add it, such as signing_key: /etc/msp-range/signing.key")
    return Path(airframe.link.signing_key)


def make(path: Path, passphrase: str | None) -> None:
    """Make a key file: at random, or from a passphrase by SHA-256, as Mission Planner, QGroundControl and MAVProxy do.

    Only its owner can read it. If root makes it on a computer with the service, it becomes the service's.

    Raises
    ------
    ConfigError
        There is a file already, or none can be made.
    """
    key = secrets.token_bytes(KEY_BYTES) if passphrase is None else hashlib.sha256(passphrase.encode()).digest()
    try:
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(key.hex() + "\n")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    with suppress(KeyError):
        if os.geteuid() == 0 and pwd.getpwnam(SERVICE_USER):
            shutil.chown(path, SERVICE_USER, SERVICE_USER)


def give(airframe: Airframe, clock: Clock, removes: bool = False) -> None:
    """Give the airframe's key to the autopilot, or remove it there, and check by its heartbeat that it did so.

    Raises
    ------
    ConfigError
        The autopilot is armed or does not take the key.
    """
    signing = signing_of(airframe.link.signing_key, clock, accepts_unsigned=True)
    assert signing is not None
    client = connect(airframe, clock, signing)
    if client.armed is not False:
        raise ConfigError("the vehicle is armed: keys are set only while it is disarmed")
    key = bytes(KEY_BYTES) if removes else read_key(key_file(airframe))
    timestamp = 0 if removes else signing.timestamp()
    target = (client.link.autopilot_system, dialect.MAV_COMP_ID_AUTOPILOT1)
    # No answer is defined for this message; the autopilot's own signature is the answer.
    client.link.send(dialect.MAVLink_setup_signing_message(*target, list(key), timestamp))
    client.wait(lambda: False, 1.0)
    if not _follows(client, signing, removes):
        found = "still signs" if removes else "does not sign with this key"
        remedy = "if it has another key, clear that in the ground station, over USB"
        if client.autopilot == "px4":
            remedy = PX4_SIGNS_NOT
        raise ConfigError(f"{airframe.link.url}: the autopilot {found}; {remedy}")


def _follows(client: ParameterClient, signing: Signing, removes: bool) -> bool:
    """Whether the autopilot's heartbeats are signed with the key, or not signed any more."""
    before = signing.verified
    client.messages.clear()
    is_there = client.wait(lambda: "HEARTBEAT" in client.messages and (removes or signing.verified > before), TAKEN_S)
    return is_there and (signing.verified > before) is not removes
