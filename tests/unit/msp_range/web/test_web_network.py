"""`msp-range web`: the drop-in that lets other devices reach the page, and what is printed of it."""

import os
import socket
import subprocess
import sys
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
    systemctl.write_text(f"""#!/bin/sh
if [ "$1" = show ]; then
    echo Environment=A=1 $(cat {tmp_path}/*.service.d/*.conf 2>/dev/null | sed -n 's/^Environment=//p' | tail -n 1)
elif [ "$1" = --version ]; then echo systemd
else echo "$@" >>{tmp_path}/asked; [ ! -e {tmp_path}/fails ]; fi
""")
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
    restart = "daemon-reload\nrestart msp-range-web.service\n"
    assert (installed / "asked").read_text() == f"{restart}enable --quiet msp-range-web.service\n{restart}"


def test_a_file_of_the_owner_counts(installed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    network.DROP_IN.parent.mkdir()
    override = network.DROP_IN.with_name("override.conf")
    override.write_text("[Service]\nEnvironment=LISTEN=192.168.1.7:9000\n")
    network.TOKEN.write_text("secret\n")
    network.show()
    assert "\nhttp://192.168.1.7:9000/?token=secret\n" in capsys.readouterr().out
    with pytest.raises(ConfigError, match="other devices still reach the page: another file"):
        network.switch(False)
    override.write_text("[Service]\nEnvironment=LISTEN=9000\n")
    network.show()
    assert capsys.readouterr().out.startswith("Only this computer reaches the page: http://127.0.0.1:9000/\n")
    with pytest.raises(ConfigError, match="only this computer reaches the page: another file"):
        network.switch(True)


def test_ipv6_is_for_those_who_ask_for_it(
    installed: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "hosts", list)
    monkeypatch.setattr(network, "hosts_6", lambda: ["2001:db8::7"])
    network.switch(True)
    network.TOKEN.write_text("secret\n")
    network.show()
    shown = capsys.readouterr().out
    assert "IPv6 addresses only" in shown
    network.DROP_IN.with_name("override.conf").write_text(shown[shown.index("[Service]") :])
    network.show()
    assert "\nhttp://[2001:db8::7]:8642/?token=secret\n" in capsys.readouterr().out


def test_the_address_of_all_families_has_ipv4_too(tmp_path: Path) -> None:
    with socket.create_server(("", 0)) as server:
        port = server.getsockname()[1]
    command = [sys.executable, "-m", "msp_range.web", f"[::]:{port}", "--socket", str(tmp_path / "none.sock")]
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, env=environment, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True
    ) as page:
        assert page.stdin is not None
        assert page.stdout is not None
        assert f"http://[::]:{port}/?token=" in page.stdout.readline()
        for host in ["127.0.0.1", *(["::1"] if socket.has_dualstack_ipv6() else [])]:
            socket.create_connection((host, port), timeout=5).close()
        page.stdin.close()
        assert page.wait(10) == 0


def test_without_systemd_there_is_no_page_of_a_service(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(installed))
    for command in (network.show, lambda: network.switch(True)):
        with pytest.raises(ConfigError, match="systemctl: No such file or directory"):
            command()
    assert not network.DROP_IN.exists()


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


@pytest.fixture
def interfaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Interfaces with their IPv4 addresses, which a test may change; eth1 has the default route, eth2 has no cable."""
    known = {"lo": "127.0.0.1", "docker0": "172.17.0.1", "eth0": "192.0.2.5", "eth1": "203.0.113.9"}
    known |= {"eth2": "192.0.2.6", "wlan0": "198.51.100.7"}

    def ioctl(asking: socket.socket, request: int, name: bytes) -> bytes:
        address = known.get(name.rstrip(b"\0").decode())
        if address is None:
            raise OSError
        return bytes(20) + socket.inet_aton(address) + bytes(8)

    monkeypatch.setattr(network.fcntl, "ioctl", ioctl)
    monkeypatch.setattr(socket, "if_nameindex", lambda: [*enumerate([*known, "down0"])])
    for name in known:
        (tmp_path / name).mkdir()
        (tmp_path / name / "carrier").write_text("0\n" if name == "eth2" else "1\n")
    (tmp_path / "route").write_text(
        "Iface Destination Gateway Flags RefCnt Use Metric Mask MTU Window IRTT\n"
        "eth0 000200C0 00000000 0001 0 0 0 00FFFFFF 0 0 0\n"
        "eth1 00000000 010200C0 0003 0 0 100 00000000 0 0 0\n"
    )
    (tmp_path / "if_inet6").write_text(
        "00000000000000000000000000000001 01 80 10 80       lo\n"
        "20010db8000000000000000000000007 02 40 00 80     eth0\n"
        "20010db800000000000000000000000b 04 40 00 80    wlan0\n"
        "20010db8000000000000000000000008 02 40 00 01     eth0\n"
        "20010db8000000000000000000000009 03 40 00 80  docker0\n"
        "fe80000000000000000000000000000a 02 40 20 80     eth0\n"
    )
    for name in ("INTERFACES", "AVAHI"):
        monkeypatch.setattr(network, name, tmp_path)
    monkeypatch.setattr(network, "ROUTES", tmp_path / "route")
    monkeypatch.setattr(network, "ADDRESSES_6", tmp_path / "if_inet6")
    return known


def test_the_first_address_is_the_one_where_a_phone_is_most_likely(interfaces: dict[str, str]) -> None:
    name = f"{socket.gethostname()}.local"
    assert network.hosts() == ["198.51.100.7", "203.0.113.9", "192.0.2.5", name]
    assert network.hosts_6() == ["2001:db8::b", "2001:db8::7"]
    del interfaces["wlan0"], interfaces["eth0"], interfaces["eth1"]
    assert network.hosts() == []
