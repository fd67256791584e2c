"""`msp-range web`: the drop-in that lets other devices reach the page, and what is printed of it."""

import socket
from pathlib import Path

import pytest

from msp_range.web import network
from msp_range.yaml_file import ConfigError


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed page: its unit, its token, and a systemctl that writes down what it is asked."""
    unit = tmp_path / "msp-range-web.service"
    unit.touch()
    monkeypatch.setattr(network, "UNIT", unit)
    monkeypatch.setattr(network, "DROP_IN", tmp_path / "msp-range-web.service.d" / "network.conf")
    monkeypatch.setattr(network, "TOKEN", tmp_path / "web-token")
    monkeypatch.setattr(network, "hosts", lambda: ["192.168.1.7", "pallet.local"])
    systemctl = tmp_path / "bin" / "systemctl"
    systemctl.parent.mkdir()
    systemctl.write_text(f'#!/bin/sh\necho "$@" >>{tmp_path}/asked\n[ ! -e {tmp_path}/fails ]\n')
    systemctl.chmod(0o755)
    monkeypatch.setenv("PATH", str(systemctl.parent), prepend=":")
    return tmp_path


def test_on_and_off_restart_the_page_and_never_the_bridge(installed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    network.switch(True)
    assert "Environment=LISTEN=0.0.0.0:8642\n" in network.DROP_IN.read_text()
    network.TOKEN.write_text("secret\n")
    network.show()
    shown = capsys.readouterr().out
    for host in ("192.168.1.7", "pallet.local"):
        assert f"http://{host}:8642/?token=secret\n" in shown
    assert "not encrypted" in shown
    network.switch(False)
    assert not network.DROP_IN.exists()
    assert not network.TOKEN.exists(), "who had the address has it no more"
    network.show()
    assert capsys.readouterr().out.startswith("Only this computer reaches the page: http://127.0.0.1:8642/\n")
    assert (installed / "asked").read_text() == 2 * "daemon-reload\nrestart msp-range-web.service\n"


def test_what_cannot_be_done_says_what_to_do(installed: Path) -> None:
    (installed / "fails").touch()
    with pytest.raises(ConfigError, match="journalctl -u msp-range-web -n 20"):
        network.switch(True)
    with pytest.raises(ConfigError, match="sudo msp-range web"):
        network.show()
    network.UNIT.unlink()
    with pytest.raises(ConfigError, match=r"install\.sh"):
        network.switch(True)


def test_addresses_are_those_at_which_others_reach_this_computer() -> None:
    for host in network.hosts():
        if not host.endswith(".local"):
            assert not host.startswith("127.")
            with socket.create_server((host, 0)) as server:
                assert server.getsockname()[0] == host


def test_addresses_of_wireless_networks_come_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = {"lo": "127.0.0.1", "eth0": "192.0.2.5", "wlan0": "198.51.100.7"}

    def ioctl(asking: socket.socket, request: int, name: bytes) -> bytes:
        address = known.get(name.rstrip(b"\0").decode())
        if address is None:
            raise OSError
        return bytes(20) + socket.inet_aton(address) + bytes(8)

    monkeypatch.setattr(network.fcntl, "ioctl", ioctl)
    monkeypatch.setattr(socket, "if_nameindex", lambda: [*enumerate([*known, "down0"])])
    monkeypatch.setattr(network, "AVAHI", tmp_path)
    assert network.hosts() == ["198.51.100.7", "192.0.2.5", f"{socket.gethostname()}.local"]
    del known["eth0"], known["wlan0"]
    assert network.hosts() == []
