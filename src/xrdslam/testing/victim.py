"""A short run of the toy method in a process of its own, for who wants to kill, stop or starve it.

`python -c "from xrdslam.testing.victim import main; main()" run RUN_DIR ENGINE [viewer]`, or `... resume RUN_DIR`:
answers as the command line does, and prints a line for each frame. Imports nothing heavy before `main`.
"""

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xrdslam.core.config import RunConfig

__all__ = ["COMMAND", "NUM_FRAMES", "main", "victim_config"]

COMMAND = (sys.executable, "-c", "from xrdslam.testing.victim import main; main()")
NUM_FRAMES = 12


def victim_config(run_dir: Path, engine: str = "multiprocess", is_watched: bool = False) -> "RunConfig":
    """Return the settings: some tenths of a second for the frames, as much to refine the map, as much to save it."""
    from xrdslam.core.config import EngineConfig, MultiprocessConfig
    from xrdslam.testing.misbehaving_viewers import MisbehavingViewerConfig
    from xrdslam.testing.toy_plugin import toy_config

    kind = MultiprocessConfig if engine == "multiprocess" else EngineConfig
    config = toy_config(kind(checkpoint_every=4), NUM_FRAMES, run_dir=str(run_dir), report=True)
    config.algo.tracking.iterations = config.algo.mapping.iterations = 20
    config.algo.mapping.final_iterations_per_keyframe = 35
    config.evaluation.pictures_every, config.evaluation.trajectory_pictures = 6, True
    if is_watched:
        config.viewer = MisbehavingViewerConfig(heard=str(run_dir / "heard.txt"))
    return config


def main() -> None:
    """Do what the arguments say."""
    from xrdslam import engine
    from xrdslam.core.errors import XrdslamError
    from xrdslam.engine import progress
    from xrdslam.testing.toy_plugin import toy_registry

    progress.LINE_EVERY_S = 0.0
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    what, folder, *rest = sys.argv[1:]
    run_dir = Path(folder)
    try:
        if what == "resume":
            summary = engine.resume(run_dir, rest, toy_registry())
        else:
            summary = engine.run(victim_config(run_dir, rest[0], rest[1:] == ["viewer"]), run_dir, toy_registry())
    except XrdslamError as error:
        sys.exit(f"xrdslam: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
    sys.exit(summary.exit_status)
