"""How the functions of the ray caster are compiled: cached on disk, without the GIL, in strict IEEE arithmetic.

Functions are unwrapped first, of the shape checks that a test run puts around them.
numba's cache looks at the file of the outermost function only: after an edit elsewhere delete `__pycache__/*.nb?`.
"""

import inspect
from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

__all__ = ["compiled", "inlined"]

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile a function; division by zero gives inf as in numpy, so that no path raises (a test each)."""
    return cast("F", njit(cache=True, nogil=True, error_model="numpy")(inspect.unwrap(function)))


def inlined(function: F) -> F:
    """Compile a function into its callers: handing a whole scene over costs six times what a ray does."""
    return cast("F", njit(cache=True, nogil=True, error_model="numpy", inline="always")(inspect.unwrap(function)))
