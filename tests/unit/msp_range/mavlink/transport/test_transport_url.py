"""Links as people write them."""

import re
import termios

import pytest

from msp_range.mavlink.transport.url import BAUD_RATES, NetworkUrl, SerialUrl, parse_url

BY_PATH = "/dev/serial/by-path/platform-fd500000.pcie-pci-0000:01:00.0-usb-0:1.2:1.0"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("udpin:0.0.0.0:14550", NetworkUrl("udpin", "0.0.0.0", 14550)),
        ("udpout:192.168.2.1:14550", NetworkUrl("udpout", "192.168.2.1", 14550)),
        ("tcp:localhost:5760", NetworkUrl("tcp", "localhost", 5760)),
        ("tcp:blueos.local.:1", NetworkUrl("tcp", "blueos.local.", 1)),
        ("tcpin:127.0.0.1:65535", NetworkUrl("tcpin", "127.0.0.1", 65535)),
        ("udpout:my_container-1:14550", NetworkUrl("udpout", "my_container-1", 14550)),
        ("serial:/dev/ttyACM0:921600", SerialUrl("/dev/ttyACM0", 921600)),
        ("serial:/dev/ttyACM0", SerialUrl("/dev/ttyACM0", 57600)),
        (f"serial:{BY_PATH}:115200", SerialUrl(BY_PATH, 115200)),
        (f"serial:{BY_PATH}", SerialUrl(BY_PATH, 57600)),
        (f"serial:{BY_PATH}-port0", SerialUrl(BY_PATH + "-port0", 57600)),
        ("serial:/run/host:1/tty", SerialUrl("/run/host:1/tty", 57600)),
        (f"{BY_PATH},115200", SerialUrl(BY_PATH, 115200)),
        ("/dev/ttyS0", SerialUrl("/dev/ttyS0", 57600)),
        ("/dev/ttyS0,38400", SerialUrl("/dev/ttyS0", 38400)),
    ],
)
def test_what_is_meant(text: str, expected: NetworkUrl | SerialUrl) -> None:
    assert parse_url(text) == expected
    assert parse_url(str(expected)) == expected


@pytest.mark.parametrize(
    ("text", "found", "expected", "example"),
    [
        ("", "''", "udpin, udpout, tcp, tcpin, serial", "udpout:192.168.2.1:14550"),
        ("udp:127.0.0.1:14550", "'udp'", "udpin, udpout, tcp, tcpin, serial", "udpout:192.168.2.1:14550"),
        ("tcp", "'tcp'", "followed by a colon", "udpout:192.168.2.1:14550"),
        ("udpin:14550", "'14550' after the kind", "udpin:HOST:PORT", "udpin:0.0.0.0:14550"),
        ("udpin::14550", "host ''", "0.0.0.0 for all", "udpin:0.0.0.0:14550"),
        ("udpout:1.2.3.4:", "port ''", "1 to 65535", "udpout:192.168.2.1:14550"),
        ("udpout:1.2.3.4:0", "port '0'", "1 to 65535", "udpout:192.168.2.1:14550"),
        ("udpout:1.2.3.4:65536", "port '65536'", "1 to 65535", "udpout:192.168.2.1:14550"),
        ("udpout:1.2.3.4:٣", "port '٣'", "1 to 65535", "udpout:192.168.2.1:14550"),
        ("tcp:1.2.3.400:5760", "host '1.2.3.400'", "IPv4 address or a name", "tcp:127.0.0.1:5760"),
        ("tcp:::1:5760", "host '::1'", "IPv4 address or a name", "tcp:127.0.0.1:5760"),
        ("tcp:a..b:5760", "host 'a..b'", "IPv4 address or a name", "tcp:127.0.0.1:5760"),
        ("tcpin:my host:5760", "host 'my host'", "IPv4 address or a name", "tcpin:0.0.0.0:5760"),
        ("serial:ttyACM0:57600", "path 'ttyACM0'", "beginning with /", "serial:/dev/serial/by-id/"),
        ("serial:", "path ''", "beginning with /", "serial:/dev/serial/by-id/"),
        ("serial:/dev/ttyACM0:57601", "baud rate '57601'", "57600, 115200", "serial:/dev/serial/by-id/"),
        ("serial:/dev/ttyACM0:fast", "baud rate 'fast'", "57600, 115200", "serial:/dev/serial/by-id/"),
        ("serial:/dev/ttyACM0:57600-8N1", "baud rate '57600-8N1'", "57600, 115200", "serial:/dev/serial/by-id/"),
        ("serial:/dev/ttyACM0:", "baud rate ''", "57600, 115200", "serial:/dev/serial/by-id/"),
        ("/dev/ttyACM0,", "baud rate ''", "57600, 115200", "serial:/dev/serial/by-id/"),
    ],
)
def test_what_is_wrong_is_reported(text: str, found: str, expected: str, example: str) -> None:
    with pytest.raises(ValueError, match="link ") as caught:
        parse_url(text)
    message = str(caught.value)
    assert message.startswith(f"link {text!r}: found {found}")
    assert expected in message.split("; expected ")[1]
    assert f"for example {example}" in message


def test_the_usual_rates_are_known() -> None:
    assert set(BAUD_RATES) == {int(name[1:]) for name in dir(termios) if re.fullmatch(r"B[1-9]\d*", name)}
