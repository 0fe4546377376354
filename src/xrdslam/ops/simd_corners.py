"""The eight corners of a cell, two features each, as the 16 lanes of one vector: lane 2 k + f is feature f of corner k.

Corner k lies on the far side of the cell along x, y, z where bits 0, 1, 2 of k are set.
"""

# numba hands its extensions untyped objects and functions:
# mypy: disable-error-code="no-untyped-call, untyped-decorator"
# ruff: noqa: ANN401

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types

from xrdslam.ops.simd import LANES, Vector, element_pointer, inline_kernel, lane_constant, llvm_intrinsic

__all__ = ["add_to_rows", "corner_weights", "paired"]

_F32, _I32 = ir.FloatType(), ir.IntType(32)
_PAIR, _ALL = ir.VectorType(_F32, 2), ir.VectorType(_F32, LANES)


def _far(axis: int, near: float, far: float) -> Any:
    lanes = [far if (lane // 2) >> axis & 1 else near for lane in range(LANES)]
    return lane_constant(lanes, f"Return {near} in the near corners along axis {axis}, {far} in the far ones.")


_near_x, _near_y, _near_z = (_far(axis, 1.0, 0.0) for axis in range(3))
_slope_x, _slope_y, _slope_z = (_far(axis, -1.0, 1.0) for axis in range(3))


@inline_kernel
def corner_weights(fx: np.float32, fy: np.float32, fz: np.float32) -> Any:
    """Return the trilinear weights of the corners at the fractions of a cell, each twice."""
    return (_near_x() + _slope_x() * fx) * (_near_y() + _slope_y() * fy) * (_near_z() + _slope_z() * fz)


@llvm_intrinsic
def paired(typingctx: Any, first: Any, second: Any) -> Any:
    """Return `first` in the even lanes and `second` in the odd ones."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        low = builder.insert_element(ir.Constant(_ALL, ir.Undefined), args[0], ir.Constant(_I32, 0))
        both = builder.insert_element(low, args[1], ir.Constant(_I32, 1))
        pick = ir.Constant(ir.VectorType(_I32, LANES), [ir.Constant(_I32, lane & 1) for lane in range(LANES)])
        return builder.shuffle_vector(both, both, pick)

    return Vector(types.float32, types.float32), codegen


@llvm_intrinsic
def add_to_rows(typingctx: Any, table: Any, rows: Any, corners: Any) -> Any:
    """Add each corner's two lanes to its row of `table` (rows, 2), one corner after the other: rows may be the same."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        table, rows, corners = args
        for k in range(LANES // 2):
            place = builder.shl(builder.extract_value(rows, k), ir.Constant(ir.IntType(64), 1))
            address = element_pointer(context, builder, sig.args[0], table, place, _PAIR)
            row = builder.load(address)
            row.align = 4
            pick = ir.Constant(ir.VectorType(_I32, 2), [ir.Constant(_I32, 2 * k), ir.Constant(_I32, 2 * k + 1)])
            share = builder.shuffle_vector(corners, ir.Constant(_ALL, ir.Undefined), pick)
            builder.store(builder.fadd(row, share), address).align = 4
        return context.get_dummy_value()

    return types.void(table, types.UniTuple(types.int64, LANES // 2), Vector), codegen
