"""A resumed run keeps its settings; what its result does not depend on may be set."""

from typing import Any

import pytest

from xrdslam.core.errors import ConfigError
from xrdslam.engine.overrides import overridden

RECORDED = {
    "algo": {"name": "toy", "tracking": {"name": "toy", "iterations": 4}, "mapping": {"name": "none"}},
    "dataset": {"family": "toy", "scene": "room0", "root": "data", "frames": [0, None, 1]},
    "engine": {"name": "sequential", "progress": True, "checkpoint_every": 50},
    "evaluation": {"every": 5, "held_out": 0},
    "viewer": {"name": "none", "port": 8000},
    "report": True,
    "seed": 0,
}


@pytest.mark.parametrize(
    "override",
    ["seed=0", "algo=toy", "algo/tracking=toy", "dataset=toy/room0", "dataset.frames=[0,null,1]", "evaluation.every=2",
     "engine.progress=false", "engine.checkpoint_every=7", "dataset.root=/elsewhere", "algo.tracking.iterations=4"],
)  # fmt: skip
def test_what_leaves_the_result_alone_may_be_set(override: str) -> None:
    key, _, value = override.partition("=")
    found: Any = overridden(RECORDED, [override])
    if "/" not in override or "root" in key:
        for part in key.split(".") if "." in key else ():
            found = found[part]
        assert "." not in key or str(found).lower().replace(" ", "").replace("none", "null") == value
    assert RECORDED["seed"] == 0


def test_another_viewer_may_watch() -> None:
    assert overridden(RECORDED, ["viewer=live", "report=false"])["viewer"] == {"name": "live"}


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("seed=1", "seed=1: would change the result of a run that was begun with seed=0"),
        ("algo=splatam", "begun with algo=toy"),
        ("algo/mapping=toy", "begun with algo/mapping=none"),
        ("dataset=toy/room1", "begun with dataset=toy/room0"),
        ("dataset.frames=[0,5,1]", "dataset.frames"),
        ("algo.tracking.iterations=5", "algo.tracking.iterations=4"),
        ("algo.tracking.speed=5", "has no setting algo.tracking.speed"),
        ("evaluation.held_out=4", "evaluation.held_out=0"),
        ("-m", "key=value"),
        ("+new=1", "key=value"),
        ("seed=[1", "no value that can be read"),
    ],
)
def test_what_would_change_the_result_is_refused(override: str, says: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        overridden(RECORDED, [override])
    assert says in str(refusal.value)


def test_another_engine_may_go_on_where_both_give_the_same_bits() -> None:
    assert overridden(RECORDED, ["engine=multiprocess"])["engine"] == {
        "name": "multiprocess",
        "progress": True,
        "checkpoint_every": 50,
    }
    strict = {"name": "multiprocess", "progress": True, "checkpoint_every": 5, "sync": "strict", "max_lag": 5}
    back = overridden(RECORDED | {"engine": strict}, ["engine=sequential"])
    assert back["engine"] == {"name": "sequential", "progress": True, "checkpoint_every": 5}
    ahead = RECORDED | {"engine": strict | {"sync": "async"}}
    assert overridden(ahead, ["engine=multiprocess"])["engine"] == ahead["engine"]
    for wrong in ("engine=sequential", "engine.sync=strict"):
        with pytest.raises(ConfigError, match="would change the result"):
            overridden(ahead, [wrong])
