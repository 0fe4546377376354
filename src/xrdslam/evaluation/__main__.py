"""`python -m xrdslam.evaluation RUN`: see `--help`."""

import os

# Before anything imports torch or numba, as in `python -m xrdslam`.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "2000")
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")

from xrdslam.command_line.evaluate import main  # the environment first

__all__ = ["main"]

if __name__ == "__main__":
    main()
