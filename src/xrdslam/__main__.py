"""`python -m xrdslam algo=<method> dataset=<family>/<scene>`: see `--help`."""

import os

# Before anything imports torch or numba: two OpenMP pools share the cores, and spinning ones starve each other.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "2000")  # a wait of microseconds between kernels is not worth a sleep
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")

__all__ = ["main"]


def main() -> None:
    """Be the command line. Imported only here: every process of a run begins by importing this module."""
    from xrdslam.command_line.main import main as command_line

    command_line()


if __name__ == "__main__":
    main()
