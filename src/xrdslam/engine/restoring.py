"""An earlier run, taken up again where a checkpoint was written, or opened to be looked at."""

from pathlib import Path
from typing import Any

from xrdslam.core.errors import RunError
from xrdslam.core.registry import Registry, installed
from xrdslam.core.saved_state import load_state, read_header
from xrdslam.engine.authorship import check_authorship
from xrdslam.engine.build import build_algorithm, build_dataset, resolve_device
from xrdslam.engine.checkpoints import newest_checkpoint
from xrdslam.engine.context import Run
from xrdslam.engine.directory import RunDirectory
from xrdslam.engine.random_numbers import restore_streams
from xrdslam.engine.recorded import read_config, typed_config

__all__ = ["load_run", "restore"]


def restore(run: Run, path: Path) -> None:
    """Take a run, just built, to where a checkpoint was written: everything it draws from or adds to is as it was.

    RunError where it was written by another version or for another method; DataError where it is damaged.
    """
    state, header = load_state(path)
    check_authorship(header, run.config.algo, run.registry, path, same_bits=True)
    _fill(run, state, header, path)
    run.next_frame = header["frame"] + 1
    run.resumed_after = [*header["resumed_after"], header["frame"]]
    run.streams = {"tracker": header.get("tracker_streams", header["streams"]), "mapper": header["streams"]}
    restore_streams(header["streams"])  # last: building has drawn from them


def load_run(run_dir: Path, registry: Registry | None = None, device: str | None = None) -> Run:
    """Open a run that ended, or the newest checkpoint of one that did not: map, trajectory, keyframes, costs.

    The dataset must be where config.yaml says: its first frame gives the map its form. The run can be evaluated and
    rendered, not gone on with. RunError where there is nothing to load, or what there is was another method's.
    """
    registry = registry or installed()
    config = typed_config(read_config(run_dir), registry)
    device = resolve_device(device or config.device)
    algorithm = build_algorithm(config.algo, config.seed, device, registry, config.evaluation.held_out)
    run = Run(config, RunDirectory(run_dir), build_dataset(config, registry), algorithm, registry, device)
    path, state, header = _newest_state(run.directory)
    check_authorship(header, config.algo, registry, path, same_bits=False)
    _fill(run, state, header, path)
    run.resumed_after = header["resumed_after"]
    return run


def _newest_state(directory: RunDirectory) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    """Return the results, or a checkpoint of a later frame: that of a run that was resumed and then killed."""
    checkpoint = newest_checkpoint(directory.path)
    ended = directory.trajectory_state
    if not ended.is_file():
        if checkpoint is None:
            raise RunError(f"{directory.path}: the run left neither results nor a checkpoint; nothing can be loaded")
        return checkpoint, *load_state(checkpoint)
    if checkpoint is not None and read_header(checkpoint)["frame"] > read_header(ended)["frame"]:
        return checkpoint, *load_state(checkpoint)
    state, header = load_state(ended)
    return ended, {**state, "model": load_state(directory.map_state)[0]}, header


def _fill(run: Run, state: dict[str, Any], header: dict[str, Any], path: Path) -> None:
    """Begin with the first frame once more, which gives the map its form, then put everything in its place."""
    first = run.dataset[int(state["trajectory"]["indices"][0])].to(run.device)
    keyframes = [run.dataset[index].to(run.device) for index in state["keyframes"]["indices"].tolist()]
    run.algorithm.start(run.scene, first)
    load = run.algorithm.load_state_dict if "tracking" in state else run.algorithm.load_results
    try:
        load(state, keyframes)
    except (KeyError, RuntimeError, ValueError) as error:
        raise RunError(
            f"{path}: does not fit algo={run.config.algo.name} as installed ({' '.join(str(error).split())})"
        ) from error
    truth = state["ground_truth"]
    run.ground_truth = dict(zip(truth["indices"].tolist(), truth["poses"], strict=True))
    run.profile.restore(header["profile"])
