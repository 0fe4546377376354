"""A finished run measured once more, from its directory."""

import json
from collections.abc import Sequence
from pathlib import Path

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from xrdslam.core.errors import ConfigError, DataError
from xrdslam.core.registry import Registry
from xrdslam.engine.restoring import load_run
from xrdslam.engine.results import evaluate, save_report
from xrdslam.engine.seeding import num_threads, prepare
from xrdslam.evaluation import EvalMetrics, EvaluationConfig, JsonValue, Metrics

__all__ = ["evaluate_again", "overlaid"]

GROUP = "evaluation."


def evaluate_again(
    run_dir: Path, overrides: Sequence[str] = (), true_mesh: Path | None = None, registry: Registry | None = None
) -> Metrics:
    """Repeat the evaluation of a run with its own settings, `evaluation.<name>=<value>` laid over them.

    Poses, map and mesh are those that the run saved, photographs and truth its dataset's (`true_mesh` in place of the
    dataset's): the figures are those of the run's end, to the bit where nothing was overridden. metrics.json, pictures
    and the report are written anew; what the run itself cost is kept.
    """
    if true_mesh is not None and not true_mesh.is_file():
        raise DataError(f"--gt-mesh {true_mesh}: no such file")
    run = load_run(run_dir, registry)
    config = overlaid(run.config.evaluation, overrides)
    if config.held_out != run.config.evaluation.held_out:
        raise ConfigError(
            f"evaluation.held_out={config.held_out}: the map of {run_dir} was built with "
            f"evaluation.held_out={run.config.evaluation.held_out}; what it has seen it cannot unsee, run it again"
        )
    run.config.evaluation = config
    prepare(run.config.seed, num_threads(run.config.threads))
    EvalMetrics(config).check()
    metrics = evaluate(run, true_mesh=true_mesh, profile_protocol=_protocol_of(run_dir))
    if run.config.report:
        save_report(run, true_mesh)
    return metrics


def overlaid(config: EvaluationConfig, overrides: Sequence[str]) -> EvaluationConfig:
    """Return the settings of an evaluation with `evaluation.<name>=<value>` laid over them."""
    strangers = [override for override in overrides if not override.startswith(GROUP) or "=" not in override]
    if strangers:
        raise ConfigError(f"{strangers[0]}: a finished run takes evaluation.<name>=<value> and nothing else")
    changes = OmegaConf.from_dotlist([override.removeprefix(GROUP) for override in overrides])
    try:
        changed = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(config), changes))
    except OmegaConfBaseException as error:
        known = ", ".join(EvaluationConfig.__dataclass_fields__)
        raise ConfigError(f"{' '.join(overrides)}: {str(error).splitlines()[0]}; there is {known}") from error
    assert isinstance(changed, EvaluationConfig)
    return changed


def _protocol_of(run_dir: Path) -> dict[str, JsonValue] | None:
    """Return under which conditions the run went, None where it ended before it could say so."""
    try:
        protocol = json.loads((run_dir / "metrics.json").read_text(encoding="utf-8")).get("profile/protocol")
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise DataError(f"{run_dir / 'metrics.json'}: damaged ({error}); remove it") from error
    return protocol if isinstance(protocol, dict) else None
