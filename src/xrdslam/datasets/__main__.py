"""`python -m xrdslam.datasets list | inspect | download | convert`: see `--help`."""

from xrdslam.command_line.datasets import main

__all__ = ["main"]

if __name__ == "__main__":
    main()
