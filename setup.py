"""What pyproject.toml cannot say: packages that lie outside `src/`, beside whatever lies in it.

`conf/` is `xrdslam.conf`; the example distribution is `xrdslam.example`, which `python -m xrdslam.plugins new` copies.
"""

from setuptools import find_namespace_packages, setup

setup(
    packages=[
        *find_namespace_packages("src", include=["hydra_plugins", "xrdslam", "xrdslam.*"], exclude=["*__pycache__*"]),
        "xrdslam.conf",
        "xrdslam.example",
    ]
)
