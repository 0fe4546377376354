"""Figures that were published for a method: data of its plugin, with where they stand."""

from dataclasses import dataclass
from importlib import resources
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from xrdslam.core.errors import PluginError
from xrdslam.core.records import AlgorithmInfo

__all__ = ["PublishedFigure", "published_figure", "published_figures"]

FIELDS = {"dataset", "scene", "metric", "value", "source"}


@dataclass(frozen=True)
class PublishedFigure:
    """A figure as somebody printed it."""

    dataset: str
    """The family."""
    scene: str
    """Of the family, or which mean over scenes (`mean of 8`)."""
    metric: str
    """The key of metrics.json that comes nearest to it."""
    value: float
    source: str
    """Who printed it, where, measured how: what keeps it from being compared without a thought."""


def published_figures(info: AlgorithmInfo) -> list[PublishedFigure]:
    """Read the figures that a plugin brings; PluginError where its file is missing or says something else."""
    if not info.published:
        return []
    package, _, name = info.published.partition(":")
    try:
        text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
        rows: Any = OmegaConf.to_container(OmegaConf.create(text))
        return [_figure(row, info.published) for row in rows["figures"]]
    except (OSError, ModuleNotFoundError, OmegaConfBaseException, KeyError, TypeError, ValueError) as error:
        raise PluginError(
            f"published figures of algorithm {info.name!r} of {info.distribution or 'an unknown distribution'}: "
            f"{info.published} cannot be read ({error}); it holds `figures:`, each with {', '.join(sorted(FIELDS))}"
        ) from error


def published_figure(figures: list[PublishedFigure], dataset: str, metric: str) -> PublishedFigure | None:
    """Return what was published for `<family>/<scene>`, else for a mean over the family's scenes, else None.

    A scene of the user's own in a family's layout (`<family>/custom`) is none of that family's.
    """
    family, _, scene = dataset.partition(" ")[0].partition("/")
    if scene == "custom":
        return None
    of_family = [figure for figure in figures if figure.dataset == family and figure.metric == metric]
    exact = [figure for figure in of_family if figure.scene == scene]
    return next(iter(exact or [figure for figure in of_family if figure.scene.startswith("mean")]), None)


def _figure(row: dict[str, Any], where: str) -> PublishedFigure:
    if row.keys() != FIELDS:
        raise ValueError(f"an entry of {where} has {sorted(row)}")
    dataset, scene, metric, source = (str(row[name]) for name in ("dataset", "scene", "metric", "source"))
    return PublishedFigure(dataset, scene, metric, float(row["value"]), source)
