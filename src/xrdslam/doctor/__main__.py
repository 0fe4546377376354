"""`python -m xrdslam.doctor`: whether runs can work here, a line for each check; status 1 where something is broken."""

import os

given = dict(os.environ)
# Before anything imports torch or numba, as in `python -m xrdslam`.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "2000")
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")

from xrdslam.doctor.examination import main  # noqa: E402  # the environment first

__all__ = ["main"]

if __name__ == "__main__":
    main(given=given)
