"""For the tests of every portion: threads and seeds."""

import os
import random
from collections.abc import Iterator

# As the command line does, before torch and numba are imported.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")

import numpy as np
import pytest
import torch


@pytest.fixture(autouse=True)
def _one_thread_and_a_seed() -> Iterator[None]:
    """Run a test on one thread, since tests are small and run side by side, and from one state of random numbers."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002  # libraries may draw from numpy's global stream
    torch.manual_seed(0)
    yield
    torch.set_num_threads(before)
