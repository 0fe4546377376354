"""Hydra's groups of the core; a plugin brings its own by an entry point in group `xrdslam.conf`."""
