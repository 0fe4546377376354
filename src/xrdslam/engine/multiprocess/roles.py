"""The processes of a run, by the names that errors, logs and `ps` give them. Imports nothing heavy."""

from enum import StrEnum

__all__ = ["Role"]


class Role(StrEnum):
    """What a process is for."""

    PARENT = "parent"
    """The one that the user started."""
    SERVER = "server"
    TRACKER = "tracker"
    MAPPER = "mapper"
    VISUALIZER = "visualizer"
