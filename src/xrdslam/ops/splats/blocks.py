"""Between images and 4x4 blocks: 16 lanes from four short rows of an image, and back."""

# numba hands its extensions untyped objects and functions:
# mypy: disable-error-code="no-untyped-call, no-untyped-def"
# ruff: noqa: ANN401

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from xrdslam.ops.simd import Vector

__all__ = ["join_rgb", "load_block", "split_rgb", "store_block"]

_F32, _I32 = ir.FloatType(), ir.IntType(32)
_QUAD = ir.VectorType(_F32, 4)


def _mask(*lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(_I32, len(lanes)), [ir.Constant(_I32, lane) for lane in lanes])


def _row_pointers(context: Any, builder: Any, array_type: Any, array: Any, index: Any, stride: Any) -> list[Any]:
    data, pointers = make_array(array_type)(context, builder, array).data, []
    for _ in range(4):
        pointers.append(builder.bitcast(builder.gep(data, [index]), _QUAD.as_pointer()))
        index = builder.add(index, stride)
    return pointers


@intrinsic
def _load_block(typingctx: Any, array: Any, index: Any, stride: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        rows = []
        for pointer in _row_pointers(context, builder, sig.args[0], *args):
            rows.append(builder.load(pointer))
            rows[-1].align = 4
        halves = [builder.shuffle_vector(*rows[k : k + 2], _mask(*range(8))) for k in (0, 2)]
        return builder.shuffle_vector(*halves, _mask(*range(16)))

    return Vector(array, types.intp, types.intp), codegen


@intrinsic
def _store_block(typingctx: Any, array: Any, index: Any, stride: Any, vector: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        array_value, first, step, value = args
        undefined = ir.Constant(value.type, ir.Undefined)
        for k, pointer in enumerate(_row_pointers(context, builder, sig.args[0], array_value, first, step)):
            row = builder.shuffle_vector(value, undefined, _mask(*range(4 * k, 4 * k + 4)))
            builder.store(row, pointer).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, Vector), codegen


def _regroup(builder: Any, a: Any, b: Any, c: Any, picks: tuple[tuple[int, int], ...]) -> Any:
    """Build each row of four from (source 0..2, lane 0..3) picks of the same row of three vectors."""
    first = [4 * row + lane + (16 if source == 1 else 0) for row in range(4) for source, lane in picks]
    both = builder.shuffle_vector(a, b, _mask(*first))
    last = [
        16 + 4 * row + lane if source == 2 else 4 * row + k
        for row in range(4)
        for k, (source, lane) in enumerate(picks)
    ]
    return builder.shuffle_vector(both, c, _mask(*last))


_SPLIT = (((0, 0), (0, 3), (1, 2), (2, 1)), ((0, 1), (1, 0), (1, 3), (2, 2)), ((0, 2), (1, 1), (2, 0), (2, 3)))
_JOIN = (((0, 0), (1, 0), (2, 0), (0, 1)), ((1, 1), (2, 1), (0, 2), (1, 2)), ((2, 2), (0, 3), (1, 3), (2, 3)))


def _regrouping(picks: Any, doc: str) -> Any:
    def regroup(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return context.make_tuple(
                builder, sig.return_type, [_regroup(builder, args[0], args[1], args[2], pick) for pick in picks]
            )

        return types.UniTuple(Vector, 3)(Vector, Vector, Vector), codegen

    regroup.__doc__ = doc
    return intrinsic(regroup)


load_block: Any = _load_block
"""Read four rows of four floats, `stride` floats apart, from flat position `index`."""
store_block: Any = _store_block
"""Write four rows of four floats, `stride` floats apart, at flat position `index`."""
split_rgb: Any = _regrouping(_SPLIT, "Return red, green, blue of a block whose rows are r g b r | g b r g | b r g b.")
join_rgb: Any = _regrouping(
    _JOIN, "Return the three vectors r g b r | g b r g | b r g b of a block's red, green, blue."
)
