"""What file names say: their natural order, the number or the time of a frame."""

import re

from xrdslam.datasets.times import NS_PER_S

__all__ = ["natural_key", "number_or_time"]

DIGITS = re.compile(r"(\d+)")
SECONDS = re.compile(r"(?:.*[^\d.])?(\d{9,11})[._](\d{1,9})")
STAMP = re.compile(r"(?:.*\D)?(\d{13}|\d{16}|\d{19})")


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Return a key by which frame2 comes before frame10."""
    parts = (part for part in DIGITS.split(name) if part)
    return tuple((0, int(part)) if part.isdigit() else (1, part) for part in parts)


def number_or_time(stem: str) -> tuple[int | None, bool]:
    """Return the frame's number in a name and false, or its time [ns] and true; none where it has no digit.

    A time is 13, 16 or 19 digits (ms, us, ns since 1970) at the end, or about ten with a fraction; else the last run of
    digits is a number.
    """
    if match := SECONDS.fullmatch(stem):
        return int(match[1]) * NS_PER_S + int(match[2].ljust(9, "0")), True
    if match := STAMP.fullmatch(stem):
        return int(match[1]) * 10 ** (19 - len(match[1])), True
    runs = DIGITS.findall(stem)
    return (int(runs[-1]), False) if runs else (None, False)
