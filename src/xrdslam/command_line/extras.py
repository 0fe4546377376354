"""The extras of the core distribution: `pip install 'xrdslam[<extra>]'`."""

from dataclasses import dataclass

__all__ = ["EXTRAS", "Extra"]


@dataclass(frozen=True)
class Extra:
    """An optional part: the modules that it brings, and what they are good for."""

    name: str
    modules: tuple[str, ...]
    gives: str
    launchers: tuple[str, ...] = ()
    """Of sweeps, as Hydra names them."""

    @property
    def command(self) -> str:
        """How to install it."""
        return f"pip install 'xrdslam[{self.name}]'"


EXTRAS = (
    Extra("gicp", ("small_gicp",), "algo/tracking=gicp"),
    Extra("exr", ("OpenEXR",), "dataset=co_fusion"),
    Extra("rosbag", ("rosbags",), "dataset=rosbag"),
    Extra("viewer", ("viser",), "viewer=viser"),
    Extra("joblib", ("joblib", "hydra_plugins.hydra_joblib_launcher"), "launcher=joblib", ("joblib",)),
    Extra("ray", ("ray", "hydra_plugins.hydra_ray_launcher"), "launcher=ray", ("ray", "ray_aws")),
    Extra(
        "submitit",
        ("submitit", "hydra_plugins.hydra_submitit_launcher"),
        "launcher=submitit_local, submitit_slurm",
        ("submitit_local", "submitit_slurm"),
    ),
)
