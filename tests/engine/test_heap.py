"""Freed memory goes back to the system, also from between what is kept."""

import subprocess
import sys

import pytest

from xrdslam.engine.heap import _malloc_trim

HOLES = """
import numpy as np
from xrdslam.engine.heap import give_back
from xrdslam.engine.profile import rss_mib
rows = [np.ones(12_500) for _ in range(2000)]  # 100 kB each: from the heap, not pages of their own
kept = rows[::2]
del rows
before = rss_mib()
give_back()
print(before - rss_mib(), sum(row.sum() for row in kept))
"""


@pytest.mark.skipif(_malloc_trim() is None, reason="the C library is not glibc")
def test_holes_between_what_is_kept_are_given_back() -> None:
    """A hundred of the two hundred MB are free, none of it at the heap's end."""
    done = subprocess.run([sys.executable, "-c", HOLES], capture_output=True, text=True, check=True)
    returned_mib, kept = map(float, done.stdout.split())
    assert returned_mib > 50
    assert kept == 12_500 * 1000
