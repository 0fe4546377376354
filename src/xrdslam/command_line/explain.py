"""What went wrong, in one line: what was asked, what there is, what to do."""

import difflib
import re
from collections.abc import Callable, Sequence

from hydra.errors import MissingConfigException

from xrdslam.command_line.extras import EXTRAS
from xrdslam.command_line.groups import options
from xrdslam.core.errors import XrdslamError
from xrdslam.core.records import AlgorithmInfo, DatasetInfo, Info, MappingMethodInfo, TrackingMethodInfo, ViewerInfo
from xrdslam.core.registry import Registry, installed

__all__ = ["in_one_line"]

KINDS: dict[str, type[Info]] = {
    kind.group: kind for kind in (AlgorithmInfo, TrackingMethodInfo, MappingMethodInfo, ViewerInfo)
}
NOT_FOR_PEOPLE = re.compile(r"^\s*(full_key|object_type|reference_type|Config search path|provider=)")
UNCHOSEN = re.compile(r"You must specify '([\w/]+)'")


def in_one_line(error: Exception, registry: Registry | None = None) -> str:
    """Return the message of an error of ours, of Hydra's or of OmegaConf's as one line."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        return _missing(str(error.missing_cfg_file), error.options or (), registry or installed())
    unchosen = UNCHOSEN.match(str(error))
    if unchosen:
        return _unchosen(unchosen[1], registry or installed())
    lines = str(error).splitlines()
    if not isinstance(error, XrdslamError) and error.__cause__ is not None:
        lines += str(error.__cause__).splitlines()
    said = dict.fromkeys(line.strip() for line in lines if line.strip() and not NOT_FOR_PEOPLE.match(line))
    return " ".join(line if line.endswith((".", "?", ":", ",")) else f"{line}." for line in said).rstrip(".")


def _missing(path: str, known: Sequence[str], registry: Registry) -> str:
    """Explain an option that no file and no schema stands for."""
    group, _, name = path.rpartition("/")
    if group in KINDS:
        return _raised(lambda: registry.get(KINDS[group], name).load_config())
    extra = next((extra for extra in EXTRAS if group == "hydra/launcher" and name in extra.launchers), None)
    if extra is not None:
        return f"launcher={name} needs the extra {extra.name!r}: {extra.command}"
    if path.startswith("dataset"):
        return _missing_scene(path.removeprefix("dataset").strip("/"), registry)
    return f"no {group}={name}{_near(name, known)}"


def _missing_scene(choice: str, registry: Registry) -> str:
    family, _, scene = choice.partition("/")
    refusal = _raised(lambda: registry.get(DatasetInfo, family).load_config())
    if refusal:
        return refusal
    scenes = sorted(options(f"dataset/{family}"))
    asked = f"dataset {family!r} has no scene {scene!r}" if scene else f"dataset={family} names no scene"
    return (
        f"{asked}{_near(scene, scenes)}; any other scene of this layout: "
        f"dataset={family}/custom dataset.path=<folder of the scene>"
    )


def _unchosen(group: str, registry: Registry) -> str:
    if group == "dataset":
        return f"choose a dataset: dataset=<family>/<scene>, one of {', '.join(sorted(options('dataset')))}"
    known = registry.all(KINDS[group]) if group in KINDS else {}
    advice = ", ".join(known) or "none is installed: pip install xrdslam-<name>"
    return f"choose {group}=<name>, one of {advice}; `--help` says what each is"


def _near(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return (f"; did you mean {near[0]!r}?" if near else ";") + f" there is {', '.join(known) or 'none'}"


def _raised(action: Callable[[], object]) -> str:
    """Return what an action that should fail says, or nothing if it does not fail."""
    try:
        action()
    except XrdslamError as error:
        return " ".join(str(error).split())
    return ""
