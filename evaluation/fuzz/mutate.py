"""Changes to bytes and to text that areas have in common."""

from collections.abc import Sequence
from random import Random

NUMBERS = (
    *("1e999", "-1e999", "1.0e+999", ".inf", "-.inf", ".nan", "nan", "inf", "NaN", "010", "08", "-0", "0b2", "1_000"),
    *("0x7fffffffffffffffff", "99999999999999999999", "12:30", "1:60.5", "1e-400", "5e-324", "1e308", "1e30", "1e12"),
    *("-1", "0", "255", "65536", "2026-13-45", "2026-10-05", "2026-10-05T25:61:61Z", "~", "null", "true", "off"),
)
"""What stands for a number in files, and mostly is none that can be used."""
WORDS = (
    *("[red]", "[/red]", "[/]", ":warning:", "<script>alert(1)</script>", "$\\frac$", "{{7*7}}", "%s%n", "a" * 5000),
    *(
        "\x1b[31m",
        "\x9b31m",
        "\x00",
        "\x07",
        "a\rb",
        "a\nb",
        "\t",
        "\u202e",
        "\ufeff",
        "\ud7ff",
        "",
        " ",
        "'",
        '"',
        "#",
    ),
    *(
        "/dev/zero",
        "/dev/stdin",
        "/proc/self/mem",
        "..",
        ".",
        "../../etc/passwd",
        "/",
        "nul\x00name",
        "x" * 300,
        "~root",
    ),
    *("front_left", "all", "serial:/dev/zero:57600", "udpin:[::1]:0", "tcp:1.2.3.4:99999", "udpout:::", "é", "日本"),
)
"""Names that somebody reads as something else."""


def of_bytes(data: bytes, rng: Random) -> bytes:
    """Some bytes changed, taken out, put in, doubled, or cut off."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        at = rng.randrange(len(out) + 1)
        size = rng.choice((1, 1, 2, 4, 8, 64, 1000))
        kind = rng.randrange(7)
        if kind == 0 and out:
            out[at % len(out)] ^= 1 << rng.randrange(8)
        elif kind == 1 and out:
            out[at % len(out)] = rng.choice((0, 1, 10, 13, 27, 34, 44, 127, 128, 255, rng.randrange(256)))
        elif kind == 2:
            out[at:at] = rng.randbytes(size)
        elif kind == 3:
            del out[at : at + size]
        elif kind == 4:
            out[at:at] = out[at : at + size] * rng.choice((1, 1, 2, 20))
        elif kind == 5:
            out[at : at + size] = bytes(size)
        else:
            del out[at:]
    return bytes(out)


def encoded(text: str, rng: Random) -> bytes:
    """Text as bytes, now and then in another encoding than it should be."""
    encoding = rng.choice(("utf-8",) * 20 + ("utf-8-sig", "utf-16", "utf-16-le", "latin-1", "utf-32"))
    return text.encode(encoding, errors="replace" if encoding == "latin-1" else "surrogatepass")


def pick(rng: Random, *groups: Sequence[str]) -> str:
    """One of the texts of one of the groups."""
    return rng.choice(rng.choice(groups))
