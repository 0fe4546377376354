"""A vector of 16 float32 lanes for numba kernels: what the compiler will not vectorise by itself is written out.

Numba does not vectorise short inner loops (runtime alias checks, no SLP pass), so the kernels of `xrdslam.ops` spell
their lanes: `Vector` lowers to LLVM's `<16 x float>`, `Mask` to `<16 x i1>`. LLVM splits them where the machine has no
512-bit registers (two AVX2 registers, four NEON ones), so the same kernel runs everywhere.

    v = load(array, i) * scale + lane_columns()        # +, -, *, / with vectors and float32 scalars
    store(array, i, select(v >= LIMIT, v, zeros()))    # >=, <, > give masks; & joins them

A scalar operand must be a numba float32 (a float32 array's element or a module-level `np.float32` constant): a Python
float is float64 inside numba and is refused at compile time. Arrays are C-contiguous, `i` counts floats from the start.

It is one long file because it is one thing, the vector type: each operation is a dozen lines that nobody reads twice.

Numba's on-disk cache looks at the file of the *calling* kernel only: after an edit here, delete the `*.nbi` files.
"""

# numba hands its extensions untyped objects and functions:
# mypy: disable-error-code="no-untyped-call, untyped-decorator, misc"
# ruff: noqa: ANN401

import inspect
import math
import operator
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array

__all__ = [
    "LANES",
    "Vector",
    "absolute",
    "any_true",
    "ceil",
    "element_pointer",
    "exp2",
    "fetch_add",
    "floor",
    "inline_kernel",
    "kernel",
    "lane_columns",
    "lane_constant",
    "lane_rows",
    "llvm_intrinsic",
    "load",
    "log2",
    "maximum",
    "minimum",
    "pack_pair",
    "parallel_kernel",
    "prefetch",
    "select",
    "splat",
    "sqrt",
    "store",
    "sum_lanes_of_16",
    "transpose",
    "zeros",
]

LANES = 16
_F32, _I32, _I1 = ir.FloatType(), ir.IntType(32), ir.IntType(1)
_VF, _VI, _VM = ir.VectorType(_F32, LANES), ir.VectorType(_I32, LANES), ir.VectorType(_I1, LANES)
_FLAGS = ("contract", "nsz", "arcp")  # not nnan/ninf: lanes that a mask throws away may overflow
_OPTIONS: dict[str, Any] = {
    "fastmath": set(_FLAGS),
    "cache": True,
    "error_model": "numpy",
    "boundscheck": False,
    "nogil": True,
}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for one thread, cached on disk; may contract, keeps NaN and infinity.

    It may not reassociate: what a process compiles is optimised once and what the next one finds on disk twice, and
    sums would be taken in different orders.
    """
    return numba.njit(**_OPTIONS)(inspect.unwrap(function))  # without the shape checks of a test run


def inline_kernel(function: Callable[..., Any]) -> Any:
    """As `kernel`, and always inlined: an array costs seven arguments, a call with a few of them some 60 cycles."""
    return numba.njit(forceinline=True, **_OPTIONS)(inspect.unwrap(function))


def parallel_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function whose `numba.prange` loops run on numba's threads; otherwise as `kernel`."""
    return numba.njit(parallel=True, **_OPTIONS)(inspect.unwrap(function))


def llvm_intrinsic(function: Callable[..., Any]) -> Any:
    """Declare a function that emits LLVM code; typed as anything, since it is called without its typing context."""
    return intrinsic(function)


class _VectorType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="float32x16")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="mask16")


Vector, Mask = _VectorType(), _MaskType()


@register_model(_VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _VF)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _VM)


def _constant(values: list[float]) -> ir.Constant:
    return ir.Constant(_VF, [ir.Constant(_F32, v) for v in values])


def _constant_i32(value: int) -> ir.Constant:
    return ir.Constant(_VI, [ir.Constant(_I32, value)] * LANES)


def _broadcast(builder: Any, scalar: Any) -> Any:
    undefined = ir.Constant(_VF, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, undefined, _constant_i32(0))


def _as_vector(builder: Any, value: Any, numba_type: Any) -> Any:
    return value if isinstance(numba_type, _VectorType) else _broadcast(builder, value)


def _is_operand(numba_type: Any) -> bool:
    return isinstance(numba_type, _VectorType) or bool(numba_type == types.float32)


def _register_binary(op: Callable[..., Any], result: Any, emit: Callable[[Any, Any, Any], Any]) -> None:
    """Give `op` a meaning for two vectors, or a vector and a float32 scalar on either side."""

    @infer_global(op)
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 2 and any(isinstance(a, _VectorType) for a in args) and all(map(_is_operand, args)):
                return signature(result, *args)
            return None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        left, right = (_as_vector(builder, a, t) for a, t in zip(args, sig.args, strict=True))
        return emit(builder, left, right)

    for pair in ((_VectorType, _VectorType), (_VectorType, types.Float), (types.Float, _VectorType)):
        lower_builtin(op, *pair)(lower)


def _arithmetic(method: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, left, right: getattr(builder, method)(left, right, flags=_FLAGS)


def _comparison(predicate: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, left, right: builder.fcmp_ordered(predicate, left, right)


for _op, _inplace, _method in (
    (operator.add, operator.iadd, "fadd"),
    (operator.sub, operator.isub, "fsub"),
    (operator.mul, operator.imul, "fmul"),
    (operator.truediv, operator.itruediv, "fdiv"),
):
    _register_binary(_op, Vector, _arithmetic(_method))
    _register_binary(_inplace, Vector, _arithmetic(_method))
for _op, _predicate in ((operator.ge, ">="), (operator.gt, ">"), (operator.lt, "<")):
    _register_binary(_op, Mask, _comparison(_predicate))


@infer_global(operator.and_)
class _MaskAnd(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(Mask, *args) if len(args) == 2 and all(isinstance(a, _MaskType) for a in args) else None


@lower_builtin(operator.and_, _MaskType, _MaskType)
def _lower_mask_and(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.and_(*args)


def element_pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, pointee: Any) -> Any:
    """Return the address of an array's flat position as a pointer to `pointee`, for intrinsics."""
    data = make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), pointee.as_pointer())


@llvm_intrinsic
def load(typingctx: Any, array: Any, index: Any) -> Any:
    """Read 16 floats from flat position `index`; no alignment asked."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = builder.load(element_pointer(context, builder, sig.args[0], args[0], args[1], _VF))
        value.align = 4
        return value

    return Vector(array, types.intp), codegen


@llvm_intrinsic
def store(typingctx: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write 16 floats at flat position `index`; no alignment asked."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], element_pointer(context, builder, sig.args[0], args[0], args[1], _VF)).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, Vector), codegen


@llvm_intrinsic
def prefetch(typingctx: Any, array: Any, index: Any) -> Any:
    """Ask for the cache line of flat position `index`; the position need not exist."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, _I32, _I32, _I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        address = element_pointer(context, builder, sig.args[0], args[0], args[1], ir.IntType(8))
        read, keep, data = (ir.Constant(_I32, k) for k in (0, 3, 1))
        builder.call(function, [address, read, keep, data])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


@llvm_intrinsic
def fetch_add(typingctx: Any, array: Any, index: Any, amount: Any) -> Any:
    """Add `amount` to an int64 array's element atomically and return what it was: hands out work to threads."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", builder.gep(data, [args[1]]), args[2], "monotonic")

    return types.int64(array, types.intp, types.int64), codegen


@llvm_intrinsic
def splat(typingctx: Any, scalar: Any) -> Any:
    """Return a vector whose lanes all are the float32 `scalar`."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _broadcast(builder, args[0])

    return Vector(types.float32), codegen


def lane_constant(values: list[float], doc: str) -> Any:
    """Make an intrinsic without arguments that returns these lanes."""

    def constant(typingctx: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return _constant(values)

        return Vector(), codegen

    constant.__doc__ = doc
    return llvm_intrinsic(constant)


zeros = lane_constant([0.0] * LANES, "Return a vector of zeros.")
lane_columns = lane_constant([float(k % 4) for k in range(LANES)], "Return each lane's column in a 4x4 block.")
lane_rows = lane_constant([float(k // 4) for k in range(LANES)], "Return each lane's row in a 4x4 block.")


@llvm_intrinsic
def select(typingctx: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Return `yes` where the mask holds and `no` elsewhere; NaN in a lane that is not taken does not leak."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(*args)

    return Vector(Mask, Vector, Vector), codegen


@llvm_intrinsic
def any_true(typingctx: Any, mask: Any) -> Any:
    """Say whether any lane of the mask holds."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(Mask), codegen


def _extremum(predicate: str, doc: str) -> Any:
    def extremum(typingctx: Any, vector: Any, limit: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            other = _as_vector(builder, args[1], sig.args[1])
            return builder.select(builder.fcmp_ordered(predicate, args[0], other), args[0], other)

        return Vector(Vector, limit), codegen

    extremum.__doc__ = doc
    return llvm_intrinsic(extremum)


minimum = _extremum("<", "Return the smaller of each lane and the limit, a vector or a float32; the limit where NaN.")
maximum = _extremum(">", "Return the larger of each lane and the limit, a vector or a float32; the limit where NaN.")


def _unary(name: str, doc: str) -> Any:
    def unary(typingctx: Any, vector: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = ir.FunctionType(_VF, [_VF])
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32")
            return builder.call(function, args)

        return Vector(Vector), codegen

    unary.__doc__ = doc
    return llvm_intrinsic(unary)


sqrt = _unary("sqrt", "Return each lane's square root.")
floor = _unary("floor", "Return each lane rounded down.")
ceil = _unary("ceil", "Return each lane rounded up.")


@llvm_intrinsic
def pack_pair(typingctx: Any, low: Any, high: Any) -> Any:
    """Return the bits of int(low) | int(high) << 16 in each lane; both in [0, 32767]."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first, last = (builder.fptosi(v, _VI) for v in args)
        return builder.bitcast(builder.or_(first, builder.shl(last, _constant_i32(16))), _VF)

    return Vector(Vector, Vector), codegen


@llvm_intrinsic
def absolute(typingctx: Any, vector: Any) -> Any:
    """Return each lane without its sign."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.and_(builder.bitcast(args[0], _VI), _constant_i32(0x7FFFFFFF))
        return builder.bitcast(bits, _VF)

    return Vector(Vector), codegen


# Minimax coefficients of 2^x on [-1/2, 1/2], lowest power first; relative error 8e-8 before rounding.
_EXP2 = (
    1.0000000716546043,
    0.6931469670622856,
    0.240221197240993,
    0.05550713277539772,
    0.0096755413240361,
    0.0013276470686003662,
)


@llvm_intrinsic
def exp2(typingctx: Any, vector: Any) -> Any:
    """Return 2^x of each lane in [-126, 127], relative error below 2e-7; other lanes are garbage, for a mask to drop.

    x = n + f with n the nearest integer: a polynomial for 2^f, and n is added to its exponent bits.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.FunctionType(_VF, [_VF])
        rint = cgutils.get_or_insert_function(builder.module, kind, f"llvm.rint.v{LANES}f32")
        whole = builder.call(rint, [args[0]])
        fraction = builder.fsub(args[0], whole)
        value = _constant([_EXP2[-1]] * LANES)
        for coefficient in _EXP2[-2::-1]:
            product = builder.fmul(value, fraction, flags=_FLAGS)
            value = builder.fadd(product, _constant([coefficient] * LANES), flags=_FLAGS)
        exponent = builder.shl(builder.fptosi(whole, _VI), _constant_i32(23))
        return builder.bitcast(builder.add(builder.bitcast(value, _VI), exponent), _VF)

    return Vector(Vector), codegen


_LOG2_SERIES = tuple(2 / math.log(2) / k for k in (1, 3, 5, 7))


@llvm_intrinsic
def log2(typingctx: Any, vector: Any) -> Any:
    """Return log2 of each lane; positive normal numbers only, absolute error below 2e-7 up to 256.

    x = 2^n m with m in [sqrt(1/2), sqrt(2)): log2 x = n + 2/ln 2 (s + s^3/3 + s^5/5 + s^7/7), s = (m - 1)/(m + 1).
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], _VI)
        above = builder.sub(bits, _constant_i32(0x3F3504F3))  # bits of sqrt(1/2)
        whole = builder.ashr(above, _constant_i32(23))
        mantissa = builder.bitcast(builder.sub(bits, builder.shl(whole, _constant_i32(23))), _VF)
        one = _constant([1.0] * LANES)
        s = builder.fdiv(builder.fsub(mantissa, one), builder.fadd(mantissa, one), flags=_FLAGS)
        squared = builder.fmul(s, s, flags=_FLAGS)
        value = _constant([_LOG2_SERIES[-1]] * LANES)
        for coefficient in _LOG2_SERIES[-2::-1]:
            product = builder.fmul(value, squared, flags=_FLAGS)
            value = builder.fadd(product, _constant([coefficient] * LANES), flags=_FLAGS)
        return builder.fadd(builder.fmul(value, s, flags=_FLAGS), builder.sitofp(whole, _VF), flags=_FLAGS)

    return Vector(Vector), codegen


@llvm_intrinsic
def transpose(typingctx: Any, rows: Any) -> Any:
    """Return the columns of 16 vectors as 16 vectors: structures of arrays to arrays of structures, or back."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        values = [builder.extract_value(args[0], k) for k in range(LANES)]
        for step in (1, 2, 4, 8):  # swap the off-diagonal squares of this side
            low = [c if not c & step else LANES + c - step for c in range(LANES)]
            high = [c + step if not c & step else LANES + c for c in range(LANES)]
            picks = [ir.Constant(_VI, [ir.Constant(_I32, k) for k in pick]) for pick in (low, high)]
            for r in range(LANES):
                if not r & step:
                    pair = values[r], values[r + step]
                    values[r], values[r + step] = (builder.shuffle_vector(*pair, pick) for pick in picks)
        return context.make_tuple(builder, sig.return_type, values)

    return types.UniTuple(Vector, LANES)(rows), codegen


def _merge(builder: Any, left: Any, right: Any, low: list[int], high: list[int]) -> Any:
    """Add two shuffles of the pair: halves the number of vectors, keeps every partial sum."""
    picks = [ir.Constant(_VI, [ir.Constant(_I32, k) for k in pick]) for pick in (low, high)]
    halves = [builder.shuffle_vector(left, right, pick) for pick in picks]
    return builder.fadd(*halves, flags=_FLAGS)


def _merge_steps() -> list[tuple[list[int], list[int]]]:
    """List the four pairs of shuffles, cheapest first: two within 128-bit quarters, two of whole quarters."""
    quarters = [4 * q for q in range(4)]
    steps = []
    for low, high in (((0, 16, 1, 17), (2, 18, 3, 19)), ((0, 1, 16, 17), (2, 3, 18, 19))):
        steps.append(([q + k for q in quarters for k in low], [q + k for q in quarters for k in high]))
    for low, high in (((0, 2, 4, 6), (1, 3, 5, 7)),) * 2:
        steps.append(([4 * q + k for q in low for k in range(4)], [4 * q + k for q in high for k in range(4)]))
    return steps


@llvm_intrinsic
def sum_lanes_of_16(typingctx: Any, vectors: Any) -> Any:
    """Return the vector whose lane k is the sum over the lanes of `vectors[k]`, a tuple of up to 16 vectors.

    A transposing tree: about three instructions a vector, where a horizontal sum of each would take nine.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        level = [builder.extract_value(args[0], k) for k in range(sig.args[0].count)]
        for low, high in _merge_steps():
            level += [_constant([0.0] * LANES)] * (len(level) % 2)
            if len(level) == 0:
                break
            pairs = zip(level[::2], level[1::2], strict=True)
            level = [_merge(builder, left, right, low, high) for left, right in pairs]
        return level[0]

    return Vector(vectors), codegen
