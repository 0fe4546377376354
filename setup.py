"""What pyproject.toml cannot say: `conf/` is the package `xrdslam.conf`, beside whatever lies in `src/`."""

from setuptools import find_namespace_packages, setup

setup(
    packages=[
        *find_namespace_packages("src", include=["hydra_plugins", "xrdslam", "xrdslam.*"], exclude=["*__pycache__*"]),
        "xrdslam.conf",
    ]
)
