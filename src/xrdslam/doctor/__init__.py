"""Whether runs can work here: `python -m xrdslam.doctor`."""
