"""What small networks need of the 16-lane vectors: matrix products over a tile, ReLU with its mask, sine and cosine.

A tile holds 32 points in its lanes: each of its rows is 32 float32 of one quantity, two vectors. Weights are broadcast,
so that eight outputs of a tile stay in sixteen registers while the inputs stream by.
"""

# numba hands its extensions untyped objects and functions:
# mypy: disable-error-code="no-untyped-call, untyped-decorator, misc"
# ruff: noqa: ANN401

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from xrdslam.ops.simd import LANES, Vector

__all__ = ["BLOCK", "TILE", "cosine", "mask_rows", "multiply_add", "relu_rows", "sine"]

TILE = 2 * LANES
BLOCK = 8
"""Rows of a tile that `multiply_add` computes at once."""
_F32, _I32, _I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_VF, _VI = ir.VectorType(_F32, LANES), ir.VectorType(_I32, LANES)
_FLAGS = ("contract", "nsz", "arcp")


def _data(context: Any, builder: Any, array_type: Any, array: Any, at: Any) -> Any:
    """Return the pointer to flat position `at`."""
    return builder.gep(make_array(array_type)(context, builder, array).data, [at])


def _read(builder: Any, pointer: Any, kind: Any = _VF) -> Any:
    value = builder.load(builder.bitcast(pointer, kind.as_pointer()))
    value.align = 4
    return value


def _write(builder: Any, pointer: Any, value: Any) -> None:
    builder.store(value, builder.bitcast(pointer, value.type.as_pointer())).align = 4


def _splat(builder: Any, scalar: Any) -> Any:
    undefined = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(_VI, [ir.Constant(_I32, 0)] * LANES))


def _integers(value: int) -> ir.Constant:
    return ir.Constant(_VI, [ir.Constant(_I32, value)] * LANES)


def _floats(value: float) -> ir.Constant:
    return ir.Constant(_VF, [ir.Constant(_F32, float(np.float32(value)))] * LANES)


@intrinsic
def multiply_add(
    typingctx: Any,
    weights: Any,
    at: Any,
    row_stride: Any,
    column_stride: Any,
    inputs: Any,
    inputs_at: Any,
    count: Any,
    outputs: Any,
    outputs_at: Any,
) -> Any:
    """Add to eight rows of a tile: y[r] += sum_k W[r, k] x[k] over `count` rows k of the inputs.

    W[r, k] is `weights[at + r * row_stride + k * column_stride]`; rows of tiles are 32 floats.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        w = _data(context, builder, sig.args[0], args[0], args[1])
        x = _data(context, builder, sig.args[4], args[4], args[5])
        y = _data(context, builder, sig.args[7], args[7], args[8])
        places = [builder.gep(y, [ir.Constant(_I64, r * TILE + v * LANES)]) for r in range(BLOCK) for v in range(2)]
        sums = [cgutils.alloca_once_value(builder, _read(builder, place)) for place in places]
        with cgutils.for_range(builder, args[6]) as loop:
            row = builder.gep(x, [builder.mul(loop.index, ir.Constant(_I64, TILE))])
            lanes = [_read(builder, builder.gep(row, [ir.Constant(_I64, v * LANES)])) for v in range(2)]
            column = builder.gep(w, [builder.mul(loop.index, args[3])])
            for r in range(BLOCK):
                element = builder.gep(column, [builder.mul(ir.Constant(_I64, r), args[2])])
                weight = _splat(builder, builder.load(element))
                for v in range(2):
                    place = sums[2 * r + v]
                    product = builder.fmul(weight, lanes[v], flags=_FLAGS)
                    builder.store(builder.fadd(builder.load(place), product, flags=_FLAGS), place)
        for place, total in zip(places, sums, strict=True):
            _write(builder, place, builder.load(total))
        return context.get_dummy_value()

    integers = (types.intp, types.intp, types.intp)
    return types.void(weights, *integers, inputs, types.intp, types.intp, outputs, types.intp), codegen


@intrinsic
def relu_rows(
    typingctx: Any, tile: Any, at: Any, bias: Any, bias_at: Any, kept: Any, kept_at: Any, outputs: Any, outputs_at: Any
) -> Any:
    """Write max(x, 0) + bias of 32 rows of one vector, and which were positive: row r is bit r of each lane's word."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        x, shift, words, y = (_data(context, builder, sig.args[i], args[i], args[i + 1]) for i in (0, 2, 4, 6))
        word = _integers(0)
        for r in range(32):
            value = _read(builder, builder.gep(x, [ir.Constant(_I64, r * TILE)]))
            positive = builder.fcmp_ordered(">", value, _floats(0.0))
            bit = builder.select(positive, _integers(-(1 << 31) if r == 31 else 1 << r), _integers(0))
            word = builder.or_(word, bit)
            added = _splat(builder, builder.load(builder.gep(shift, [ir.Constant(_I64, r)])))
            kept_value = builder.fadd(builder.select(positive, value, _floats(0.0)), added, flags=_FLAGS)
            _write(builder, builder.gep(y, [ir.Constant(_I64, r * TILE)]), kept_value)
        _write(builder, words, word)
        return context.get_dummy_value()

    return types.void(tile, types.intp, bias, types.intp, kept, types.intp, outputs, types.intp), codegen


@intrinsic
def mask_rows(typingctx: Any, tile: Any, at: Any, kept: Any, kept_at: Any, outputs: Any, outputs_at: Any) -> Any:
    """Write 32 rows of one vector, zero where the words of `relu_rows` say that the row was not positive."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        x, words, y = (_data(context, builder, sig.args[i], args[i], args[i + 1]) for i in (0, 2, 4))
        word = _read(builder, words, _VI)
        for r in range(32):
            value = _read(builder, builder.gep(x, [ir.Constant(_I64, r * TILE)]))
            bit = builder.and_(word, _integers(-(1 << 31) if r == 31 else 1 << r))
            through = builder.select(builder.icmp_signed("!=", bit, _integers(0)), value, _floats(0.0))
            _write(builder, builder.gep(y, [ir.Constant(_I64, r * TILE)]), through)
        return context.get_dummy_value()

    return types.void(tile, types.intp, kept, types.intp, outputs, types.intp), codegen


# Odd minimax fit of sin r on [-pi/2, pi/2], lowest power first; error 4e-9 before rounding.
_SINE = (0.99999999763, -0.16666647484, 0.0083328972524, -0.00019800739045, 2.5901670329e-06)
_PI_HIGH = float(np.float32(math.pi))
_PI_LOW = math.pi - _PI_HIGH


def _call(builder: Any, name: str, *vectors: Any) -> Any:
    kind = ir.FunctionType(_VF, [_VF] * len(vectors))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32"), vectors)


def _wave(half: float) -> Any:
    """Build sin(x + half * pi), half 0 or 1/2: x = (n - half) pi + r with |r| <= pi / 2, so it is (-1)^n sin r.

    The subtraction is two fused multiply-adds.
    """

    def wave(typingctx: Any, vector: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            turns = builder.fadd(builder.fmul(args[0], _floats(1 / math.pi)), _floats(half))
            whole = _call(builder, "rint", turns)
            shifted = _call(builder, "fma", whole, _floats(1.0), _floats(-half))
            r = _call(builder, "fma", shifted, _floats(-_PI_HIGH), args[0])
            r = _call(builder, "fma", shifted, _floats(-_PI_LOW), r)
            squared = builder.fmul(r, r, flags=_FLAGS)
            value = _floats(_SINE[-1])
            for coefficient in _SINE[-2::-1]:
                product = builder.fmul(value, squared, flags=_FLAGS)
                value = builder.fadd(product, _floats(coefficient), flags=_FLAGS)
            value = builder.fmul(value, r, flags=_FLAGS)
            sign = builder.shl(builder.fptosi(whole, _VI), _integers(31))
            return builder.bitcast(builder.xor(builder.bitcast(value, _VI), sign), _VF)

        return Vector(Vector), codegen

    wave.__doc__ = f"Return the {'cosine' if half else 'sine'} of each lane [rad]; absolute error below 3e-7 up to 1e4."
    return intrinsic(wave)


sine, cosine = _wave(0.0), _wave(0.5)
