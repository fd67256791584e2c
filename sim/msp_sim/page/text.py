"""Numbers as pages and pictures write them; nothing here needs matplotlib."""

import re


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


def plus(number: float, digits: int = 1) -> str:
    """Return a signed number with a true minus sign; no sign for what rounds to 0.

    Examples
    --------
    >>> plus(-1.26), plus(0.04), plus(3.0)
    ('−1.3', '0.0', '+3.0')
    """
    text = f"{number:+.{digits}f}"
    return text[1:] if float(text) == 0.0 else text.replace("-", "−")


def number(value: float | None, digits: int) -> str:
    """Return a number with so many digits, and a dash where there is none."""
    return "–" if value is None else minus(f"{value:.{digits}f}")


def sentence(text: str) -> str:
    """Return a text that begins with a capital and ends with a full stop, its minus signs as long as its plus signs.

    Examples
    --------
    >>> sentence("nothing grows with range"), sentence("Said."), sentence("")
    ('Nothing grows with range.', 'Said.', '')
    """
    text = minus(text.strip())
    return text[:1].upper() + text[1:] + ("" if not text or text[-1] in ".?!" else ".")
