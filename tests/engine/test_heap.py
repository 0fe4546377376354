"""Freed memory goes back to the system when it is to, also from between what is kept, and where told so not before."""

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


BLOCKS = """
import resource, sys
import numpy as np
from xrdslam.engine.heap import keep
if "keep" in sys.argv:
    keep()
for i in range(102):
    blocks = [np.empty(250_000) for _ in range(4)]  # 2 MB each: some 488 pages
    for block in blocks:
        block[::512] = 1.0
    if i == 1:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    del blocks, block
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(_malloc_trim() is None, reason="the C library is not glibc")
def test_what_is_freed_and_taken_again_stays_with_the_process_where_it_is_kept() -> None:
    """Each of a hundred rounds takes the memory of the one before, or asks the system for it anew."""
    told, untold = (
        int(subprocess.run([sys.executable, "-c", BLOCKS, *words], capture_output=True, check=True).stdout)
        for words in (["keep"], [])
    )
    assert told < 488
    assert untold > 100 * 488
