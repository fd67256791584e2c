"""Numbers, lists and sentences as pages, pictures and terminals write them; nothing here needs matplotlib."""

import math
import re
from collections.abc import Sequence


def p_text(p_value: float) -> str:
    """A p-value as text with two digits, never zero.

    Examples
    --------
    >>> p_text(0.4123), p_text(0.0), p_text(3.2e-5)
    ('0.41', 'below 1e-12', '3.2e-05')
    """
    return "below 1e-12" if p_value < 1e-12 else f"{p_value:.2g}"


def minus(text: str) -> str:
    """Return a text whose hyphens before numbers are minus signs.

    Examples
    --------
    >>> minus("-1.39 cm (-1.57 to -1.20), 40-60 cm")
    '−1.39 cm (−1.57 to −1.20), 40-60 cm'
    """
    return re.sub(r"(?<![\w.])-(?=\d)", "−", text)


def plus(number: float | None, digits: int = 1) -> str:
    """Return a signed number with a true minus sign, without a sign for what rounds to 0; nothing for no number.

    Examples
    --------
    >>> plus(-1.26), plus(0.04), plus(3.0), plus(None)
    ('−1.3', '0.0', '+3.0', '')
    """
    if number is None or math.isnan(number):
        return ""
    text = f"{number:+.{digits}f}"
    return text[1:] if float(text) == 0.0 else text.replace("-", "−")


def number(value: float | None, digits: int) -> str:
    """Return a number with this many decimals; a dash for None."""
    return "–" if value is None else minus(f"{value:.{digits}f}")


def counted(count: int, noun: str) -> str:
    """Return 'one peak' or '3 peaks'."""
    return f"one {noun}" if count == 1 else f"{count:,} {noun}s"


def and_list(parts: Sequence[str]) -> str:
    """Parts of a sentence, the last two joined by 'and'.

    Examples
    --------
    >>> and_list(["a", "b", "c"]), and_list(["a"])
    ('a, b and c', 'a')
    """
    return " and ".join([*([", ".join(parts[:-1])] if len(parts) > 1 else []), *parts[-1:]])


def listed(names: Sequence[str], most: int = 12) -> str:
    """The first of many names, and how many more there are.

    Examples
    --------
    >>> listed(["a", "b", "c"]), listed(["a", "b", "c"], most=2)
    ('a, b, c', 'a, b and 1 more')
    """
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def capitalised(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    """Return a text that begins with a capital and ends with a full stop, its minus signs as long as its plus signs.

    Examples
    --------
    >>> sentence("nothing grows with range"), sentence("Said."), sentence("")
    ('Nothing grows with range.', 'Said.', '')
    """
    text = capitalised(minus(text.strip()))
    return text + ("" if not text or text[-1] in ".?!" else ".")
