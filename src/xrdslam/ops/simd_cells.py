"""The cells of a grid level that 16 points fall into, a point a lane: the features of all corners are gathered at once.

A row of the table is two float32, read as one number of 64 bits.
"""

# numba hands its extensions untyped objects and functions:
# mypy: disable-error-code="no-untyped-call, untyped-decorator, misc"
# ruff: noqa: ANN401

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from xrdslam.ops.simd import LANES, element_pointer

__all__ = ["PRIMES", "gather_dense", "gather_hashed"]

PRIMES = (2654435761, 805459861)
"""What the hash multiplies y and z by."""
_F32, _I32, _I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_VF, _VI, _VM = (ir.VectorType(t, LANES) for t in (_F32, _I32, ir.IntType(1)))
_HALF_LONGS, _HALF_PLACES = (ir.VectorType(t, LANES // 2) for t in (_I64, _I64.as_pointer()))
_FLAGS = ("contract", "nsz", "arcp")


def _floats(value: float) -> ir.Constant:
    return ir.Constant(_VF, [ir.Constant(_F32, float(np.float32(value)))] * LANES)


def _integers(value: int, kind: Any = _VI) -> ir.Constant:
    return ir.Constant(kind, [ir.Constant(kind.element, value)] * kind.count)


def _splat(builder: Any, scalar: Any, kind: Any) -> Any:
    undefined = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, undefined, _integers(0, ir.VectorType(_I32, kind.count)))


def _call(builder: Any, name: str, vector: Any) -> Any:
    kind = ir.FunctionType(_VF, [_VF])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32"), [vector])


def _cell(builder: Any, coordinate: Any, scale: Any) -> tuple[Any, Any]:
    """Return cell and fraction; what is no number, or far outside, falls into cell 0."""
    place = builder.fadd(builder.fmul(coordinate, scale, flags=_FLAGS), _floats(0.5), flags=_FLAGS)
    near = builder.fcmp_ordered("<", _call(builder, "fabs", place), _floats(16777216.0))
    whole = _call(builder, "floor", place)
    fraction = builder.select(near, builder.fsub(place, whole), _floats(0.0))
    return builder.fptosi(builder.select(near, whole, _floats(0.0)), _VI), fraction


def _pairs(builder: Any, table: Any, rows: Any) -> tuple[Any, Any]:
    """Return both features of 16 rows: two gathers of eight."""
    start = _splat(builder, builder.ptrtoint(table, _I64), _HALF_LONGS)
    kind = ir.FunctionType(_HALF_LONGS, [_HALF_PLACES, _I32, ir.VectorType(ir.IntType(1), LANES // 2), _HALF_LONGS])
    gather = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.gather.v8i64.v8p0i64")
    always = _integers(1, ir.VectorType(ir.IntType(1), LANES // 2))
    halves = []
    for half in range(2):
        pick = [ir.Constant(_I32, half * LANES // 2 + k) for k in range(LANES // 2)]
        some = builder.shuffle_vector(rows, rows, ir.Constant(ir.VectorType(_I32, LANES // 2), pick))
        offset = builder.shl(builder.zext(some, _HALF_LONGS), _integers(3, _HALF_LONGS))
        places = builder.inttoptr(builder.add(start, offset), _HALF_PLACES)
        found = builder.call(gather, [places, ir.Constant(_I32, 4), always, ir.Constant(_HALF_LONGS, ir.Undefined)])
        halves.append(builder.bitcast(found, _VF))
    even = ir.Constant(_VI, [ir.Constant(_I32, 2 * k) for k in range(LANES)])
    odd = ir.Constant(_VI, [ir.Constant(_I32, 2 * k + 1) for k in range(LANES)])
    return builder.shuffle_vector(*halves, even), builder.shuffle_vector(*halves, odd)


def _write(builder: Any, pointer: Any, row: int, vector: Any) -> None:
    place = builder.gep(pointer, [ir.Constant(_I64, row)])
    builder.store(vector, place).align = 4


def _gather(is_hashed: bool, doc: str) -> Any:
    def gather(
        typingctx: Any, points: Any, at: Any, stride: Any, scale: Any, size: Any, first: Any, table: Any, out: Any
    ) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            _, at, stride, scale, size, first, _, _ = args
            scales = _splat(builder, scale, _VF)
            cells, fractions = [], []
            for axis in range(3):
                index = builder.add(at, builder.mul(stride, ir.Constant(_I64, axis)))
                value = builder.load(element_pointer(context, builder, sig.args[0], args[0], index, _VF))
                value.align = 4
                cell, fraction = _cell(builder, value, scales)
                cells.append(cell)
                fractions.append(fraction)
            table = element_pointer(context, builder, sig.args[6], args[6], ir.Constant(_I64, 0), _I64)
            target = element_pointer(context, builder, sig.args[7], args[7], ir.Constant(_I64, 0), _VF)
            size, first = (_splat(builder, builder.trunc(n, _I32), _VI) for n in (size, first))

            def emit(rows: list[Any]) -> None:
                for axis, fraction in enumerate(fractions):
                    _write(builder, target, axis, fraction)
                for k, row in enumerate(rows):
                    for feature, value in enumerate(_pairs(builder, table, builder.add(first, row))):
                        _write(builder, target, 3 + 8 * feature + k, value)

            one = _integers(1)
            if is_hashed:
                mask = builder.sub(size, one)
                x = [cells[0], builder.add(cells[0], one)]
                y, z = (
                    [builder.mul(cell, _integers(prime)) for cell in (base, builder.add(base, one))]
                    for base, prime in zip(cells[1:], PRIMES, strict=True)
                )
                emit([
                    builder.and_(builder.xor(builder.xor(x[k & 1], y[k >> 1 & 1]), z[k >> 2]), mask) for k in range(8)
                ])  # fmt: skip
                return ir.Constant(ir.IntType(1), 1)
            last = builder.sub(size, one)
            inside = _integers(1, _VM)
            for cell in cells:
                inside = builder.and_(inside, builder.icmp_unsigned("<", cell, last))
            bits = builder.bitcast(inside, ir.IntType(LANES))
            fits = builder.icmp_unsigned("==", bits, ir.Constant(ir.IntType(LANES), (1 << LANES) - 1))
            with builder.if_then(fits):
                steps = [one, size, builder.mul(size, size)]
                base = builder.add(
                    cells[0], builder.add(builder.mul(cells[1], steps[1]), builder.mul(cells[2], steps[2]))
                )
                rows = [base]
                for step in steps:
                    rows += [builder.add(row, step) for row in rows]
                emit(rows)
            return fits

        integers = (types.intp, types.intp)
        signature = types.boolean(points, *integers, types.float32, *integers, table, out)
        return signature, codegen

    gather.__doc__ = doc
    return intrinsic(gather)


gather_dense = _gather(
    False,
    """Write fractions (3) and the corners' first and second features (8, 8) of 16 points, each a vector.

    `points` has x, y and z of the points from `at` on, `stride` apart; the level has `size` vertices an axis and rows
    from `first` on. Return False, and write nothing, where a point lies outside.
    """,
)
gather_hashed = _gather(True, "As `gather_dense`, where `size`, a power of two, is the number of rows shared by hash.")
