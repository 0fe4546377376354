"""`python -m xrdslam algo=<method> dataset=<family>/<scene>`: see `--help`."""

import os

# Before anything imports torch or numba: two OpenMP pools share the cores, and spinning ones starve each other.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "2000")  # a wait of microseconds between kernels is not worth a sleep
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")

from xrdslam.command_line.main import main  # the environment first

__all__ = ["main"]

if __name__ == "__main__":
    main()
