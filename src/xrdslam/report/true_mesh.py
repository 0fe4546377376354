"""The true surface of a run's scene, found again through the settings of its dataset."""

import logging
from pathlib import Path

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from xrdslam.core.errors import XrdslamError
from xrdslam.core.registry import Registry
from xrdslam.report.run_files import RunFiles

__all__ = ["true_mesh_of"]

log = logging.getLogger(__name__)


def true_mesh_of(run: RunFiles, registry: Registry) -> Path | None:
    """Return the mesh file of the dataset that a run was on; None where it has none, or is not here (said then)."""
    settings = run.config.get("dataset", {})
    try:
        info = registry.dataset(str(settings.get("family")))
        typed = OmegaConf.merge(OmegaConf.structured(info.load_config()), settings)
        mesh: Path | None = info.load()(OmegaConf.to_object(typed)).ground_truth_mesh
    except (XrdslamError, OmegaConfBaseException, OSError) as error:
        log.warning("the true surface of %s is not at hand: %s", run.dataset, error)
        return None
    return mesh
