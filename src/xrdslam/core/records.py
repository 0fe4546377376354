"""What a distribution registers: a name, and where to find what it stands for. Nothing heavy is imported to say so."""

import importlib
from dataclasses import dataclass
from typing import Any, ClassVar

from xrdslam.core.errors import PluginError

__all__ = [
    "AlgorithmInfo",
    "DatasetInfo",
    "Info",
    "MappingMethodInfo",
    "MetricInfo",
    "TrackingMethodInfo",
    "ViewerInfo",
]


@dataclass(frozen=True)
class Info:
    """A registered name. `target` and `config` are import strings, `module:Class`, imported when they are asked for."""

    name: str
    target: str
    config: str = ""
    """The dataclass of its settings, in a module that imports no torch."""
    summary: str = ""
    """One line for `--help`."""
    distribution: str = ""
    """`<name> <version>` of who registered it; the registry fills it in."""

    kind: ClassVar[str] = "thing"
    """The word that messages use."""
    group: ClassVar[str] = ""
    """The Hydra group that chooses it."""

    def load(self) -> Any:  # noqa: ANN401  # what it is depends on the kind
        """Import what the name stands for."""
        return self._import(self.target)

    def load_config(self) -> Any:  # noqa: ANN401  # a dataclass, for which there is no type
        """Import the dataclass of its settings."""
        return self._import(self.config)

    def _import(self, path: str) -> object:
        """Import `module:attribute`; whatever goes wrong is the plugin's, and the message says whose."""
        module, _, attribute = path.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (Exception, SystemExit) as error:
            raise PluginError(
                f"{self.kind} {self.name!r} of {self.distribution or 'an unknown distribution'} cannot be loaded: "
                f"importing {path!r} raised {type(error).__name__}: {error}"
            ) from error


@dataclass(frozen=True)
class AlgorithmInfo(Info):
    """A method, and the tracking and mapping methods that it takes unless the user says otherwise."""

    tracking: str = "constant_velocity"
    mapping: str = "none"
    paper: str = ""
    published: str = ""
    """`package:file.yaml` of figures that were published for it (see xrdslam.report.published)."""

    kind: ClassVar[str] = "algorithm"
    group: ClassVar[str] = "algo"


@dataclass(frozen=True)
class TrackingMethodInfo(Info):
    """A way of finding where a frame was taken."""

    kind: ClassVar[str] = "tracking method"
    group: ClassVar[str] = "algo/tracking"


@dataclass(frozen=True)
class MappingMethodInfo(Info):
    """A way of putting frames into the map."""

    kind: ClassVar[str] = "mapping method"
    group: ClassVar[str] = "algo/mapping"


@dataclass(frozen=True)
class DatasetInfo(Info):
    """A family of sequences that share a file layout."""

    kind: ClassVar[str] = "dataset family"
    group: ClassVar[str] = "dataset"


@dataclass(frozen=True)
class MetricInfo(Info):
    """A figure of a finished run."""

    kind: ClassVar[str] = "metric"
    group: ClassVar[str] = "evaluation"


@dataclass(frozen=True)
class ViewerInfo(Info):
    """A way of watching a run."""

    kind: ClassVar[str] = "viewer"
    group: ClassVar[str] = "viewer"
