"""`viewer=none`: nobody watches."""

from xrdslam.core.config import ViewerConfig

__all__ = ["NoViewer"]


class NoViewer:
    """Listens to nothing, shows nothing."""

    def __init__(self, config: ViewerConfig) -> None:
        """Take the settings that every viewer takes."""

    def close(self) -> None:
        """Do nothing."""
