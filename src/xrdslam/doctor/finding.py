"""What one check found."""

from dataclasses import dataclass

__all__ = ["Finding", "fail", "ok", "warn"]

WIDTH = 22
"""Of the column of names."""


@dataclass(frozen=True)
class Finding:
    """A line: what was looked at, how it is, and what to do where it is not well."""

    check: str
    status: str
    """ok; warn, where runs work but not as well as they could, or not in every way; FAIL, where they do not."""
    found: str
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.status:<5}{self.check:<{WIDTH}}{self.found}" + (f"; {self.advice}" if self.advice else "")


def ok(check: str, found: str) -> Finding:
    """Return a finding that asks for nothing."""
    return Finding(check, "ok", found)


def warn(check: str, found: str, advice: str) -> Finding:
    """Return a finding that runs survive."""
    return Finding(check, "warn", found, advice)


def fail(check: str, found: str, advice: str) -> Finding:
    """Return a finding that no run, or not the one that is meant, survives."""
    return Finding(check, "FAIL", found, advice)
