"""Settings of the live page. Imports nothing heavy."""

from dataclasses import dataclass

from xrdslam.core.config import ViewerConfig, require

__all__ = ["LiveViewerConfig"]


@dataclass
class LiveViewerConfig(ViewerConfig):
    """A page that shows the run while it goes on."""

    name: str = "viser"
    host: str = "127.0.0.1"
    """Who may look: this machine alone. The page has no password; `0.0.0.0` shows it to the network."""
    port: int = 8080
    """The next free one is taken where this one is not."""
    share: float = 0.05
    """Of the run's time, the most that it may spend on the page while a browser looks; without a browser it is none."""
    width: int = 240
    """Of the input and the rendering on the page [px]."""
    max_points: int = 60_000
    """Of the map; more are thinned."""

    def __post_init__(self) -> None:
        require(0 < self.port < 65536, "viewer.port", self.port, "be a port, 1 to 65535")
        require(0 < self.share <= 1, "viewer.share", self.share, "be above 0 and at most 1")
        require(self.width >= 16, "viewer.width", self.width, "be at least 16 px")
        require(self.max_points >= 1, "viewer.max_points", self.max_points, "be at least 1")
