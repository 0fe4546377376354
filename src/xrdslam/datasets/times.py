"""Time in files: exact integer nanoseconds, and which moment of one list belongs to which of another."""

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation

import numpy as np
from jaxtyping import Int64

from xrdslam.core.errors import DataError

__all__ = ["NS_PER_S", "associated", "nanoseconds"]

NS_PER_S = 1_000_000_000


def nanoseconds(text: str, source: str, unit: int = NS_PER_S) -> int:
    """Return a time written in decimal as whole nanoseconds; `unit` is how many of them one of the file's units is.

    Decimal arithmetic: a float64 resolves a time since 1970 to some 200 ns only. `source` names the file in errors.
    """
    try:
        value = Decimal(text)
        if not value.is_finite():
            raise InvalidOperation
        return int((value * unit).to_integral_value())
    except InvalidOperation as error:
        raise DataError(f"{source}: {text[:40]!r} is not a time; mend the line") from error


def associated(
    first_ns: Sequence[int], second_ns: Sequence[int], tolerance_ns: int
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Return for each time of the first list the index of its partner in the second, or -1, and their difference [ns].

    Partners are at most `tolerance_ns` apart; the closest pairs are joined first, and each time has one partner at
    most. The difference is to the partner, or, where there is none, to the nearest of all.
    """
    first, second = np.asarray(first_ns, dtype=np.int64), np.asarray(second_ns, dtype=np.int64)
    partners = np.full(len(first), -1, dtype=np.int64)
    nearest = np.full(len(first), np.iinfo(np.int64).max, dtype=np.int64)
    if len(second) == 0 or len(first) == 0:
        return partners, nearest
    order = np.argsort(second, kind="stable")
    place = np.searchsorted(second[order], first)
    around = np.clip(place[:, None] + np.arange(-2, 2), 0, len(second) - 1)  # two before, two after
    candidates = order[around]
    apart = np.abs(second[candidates] - first[:, None])
    nearest = apart.min(1)
    is_taken = np.zeros(len(second), dtype=bool)
    for flat in np.argsort(apart, axis=None, kind="stable"):
        i, j = divmod(int(flat), candidates.shape[1])
        if apart[i, j] > tolerance_ns:
            break
        if partners[i] < 0 and not is_taken[candidates[i, j]]:
            partners[i] = candidates[i, j]
            is_taken[candidates[i, j]] = True
            nearest[i] = apart[i, j]
    return partners, nearest
