"""SIMD vectors: as many numbers as a core's widest registers hold, loaded, multiplied and added as one value in compiled loops.

Compilers do not find out for themselves how to keep the sums of a convolution in registers, so it is spelt out here: a `Vector` holds as
many numbers in single precision as the widest registers do, as far as the compiler is told of them. Where numbers are longer, several
registers make up one vector, so the same source serves both precisions and every processor.

>>> import numpy as np
>>> from numba import njit
>>> @njit
... def squares_of(x):
...     vector = load(x, 0)
...     return horizontal_sum(multiply_add(broadcast(x.dtype.type(0)), vector, vector))
>>> squares_of(np.full(VECTOR_SIZE, 0.5, np.float32)) == 0.25 * VECTOR_SIZE
True
"""

# pyright: reportCallIssue=false, reportAttributeAccessIssue=false, reportGeneralTypeIssues=false
# An intrinsic is called with other arguments than it is declared with, and numba's types tell pyright little.

import math
from functools import cache
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import config
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic, models, overload, register_model


@cache
def has(feature: str) -> bool:
    """Whether the processor that numba compiles for has this (NUMBA_CPU_FEATURES, by default the machine's own)."""
    chosen = getattr(config, "CPU_FEATURES", None)
    return bool(binding.get_host_cpu_features().get(feature)) if chosen is None else f"+{feature}" in chosen.split(",")


VECTOR_SIZE = 16 if has("avx512f") else 8
"""Numbers in a vector: as many as fit the widest registers in single precision, of AVX-512 or AVX2, or two of NEON's."""


class Vector(types.Type):
    """The numba type of a SIMD vector."""

    def __init__(self, dtype: types.Type) -> None:
        self.dtype = dtype
        super().__init__(name=f"Vector({dtype})")


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Vector) -> None:
        super().__init__(manager, kind, ir.VectorType(manager.lookup(kind.dtype).get_value_type(), VECTOR_SIZE))


def pointer_to(context: Any, builder: Any, kind: types.Array, numbers: Any, first: Any, vector: ir.VectorType) -> Any:
    return builder.bitcast(builder.gep(context.make_array(kind)(context, builder, numbers).data, [first]), vector.as_pointer())


@intrinsic
def load(_: Any, numbers: types.Array, first: types.Integer) -> Any:
    """A vector of an array's numbers, from an index on; of numbers in bfloat16 (uint16) twice as many, as pairs."""
    kind = types.uint32 if numbers.dtype == types.uint16 else numbers.dtype

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        vector = context.get_value_type(signature.return_type)
        return builder.load(pointer_to(context, builder, numbers, *values, vector), align=numbers.dtype.bitwidth // 8)

    return Vector(kind)(numbers, types.intp), code


@intrinsic
def store(_: Any, numbers: types.Array, first: types.Integer, vector: Vector) -> Any:
    """Write a vector into an array, from an index on."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = pointer_to(context, builder, numbers, *values[:2], values[2].type)
        builder.store(values[2], pointer, align=numbers.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(numbers, types.intp, vector), code


def repeated(builder: Any, number: Any, vector: ir.VectorType) -> Any:
    """LLVM's code for a vector of one number."""
    nothing = ir.Constant(vector, ir.Undefined)
    one = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(ir.IntType(32), VECTOR_SIZE), None))


@intrinsic
def broadcast(_: Any, number: types.Number) -> Any:
    """A vector of one number, repeated."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return repeated(builder, values[0], context.get_value_type(signature.return_type))

    return Vector(number)(number), code


@intrinsic
def broadcast_at(_: Any, numbers: types.Array, index: types.Integer) -> Any:
    """A vector of the number at an index, repeated; numba's own indexing asks of each index whether it is negative."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        vector = context.get_value_type(signature.return_type)
        number = builder.load(builder.gep(context.make_array(numbers)(context, builder, values[0]).data, [values[1]]))
        return repeated(builder, number, vector)

    return Vector(numbers.dtype)(numbers, types.intp), code


class Pairs(ir.Type):
    """LLVM's type of a vector of pairs in bfloat16."""

    def _to_string(self) -> str:
        return f"<{2 * VECTOR_SIZE} x bfloat>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pairs)

    def __hash__(self) -> int:
        return hash(Pairs)


@intrinsic
def multiply_add(_: Any, total: Vector, x: Vector, y: Vector) -> Any:
    """total + x y; of pairs in bfloat16 (uint32) both products, by the instruction that AVX-512 has for it."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fadd(values[0], builder.fmul(*values[1:], flags=("fast",)), flags=("fast",))

    def code_of_pairs(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        shape = ir.FunctionType(values[0].type, [values[0].type, Pairs(), Pairs()])
        add_products = get_or_insert_function(builder.module, shape, "llvm.x86.avx512bf16.dpbf16ps.512")
        return builder.call(add_products, [values[0], *(builder.bitcast(each, Pairs()) for each in values[1:])])

    return total(total, x, y), code_of_pairs if x.dtype == types.uint32 else code


@intrinsic
def horizontal_sum(_: Any, vector: Vector) -> Any:
    """The sum of a vector's numbers."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        number = context.get_value_type(vector.dtype)
        shape = ir.FunctionType(number, [number, values[0].type])
        name = f"llvm.vector.reduce.fadd.v{VECTOR_SIZE}f{vector.dtype.bitwidth}"
        return builder.call(get_or_insert_function(builder.module, shape, name), [ir.Constant(number, 0.0), values[0]], fastmath=("fast",))

    return vector.dtype(vector), code


def tanh(x: Any) -> Any:
    """In double precision the C library's, one number at a time; in single precision products and one division, which vectorise.

    The latter is Lambert's continued fraction at x / 4, then twice tanh(2 y) = 2 t / (1 + t^2) with t = tanh(y); it errs by 2e-7 at most.
    """
    raise NotImplementedError


@overload(tanh, jit_options={"fastmath": True, "error_model": "numpy"})
def tanh_at(x):
    if x != types.float32:
        return lambda x: math.tanh(x)
    a1, a2, a3 = np.float32(17325 / 135135), np.float32(378 / 135135), np.float32(1 / 135135)
    b1, b2, b3 = np.float32(62370 / 135135), np.float32(3150 / 135135), np.float32(28 / 135135)
    most, quarter, one, two = np.float32(9.1), np.float32(0.25), np.float32(1), np.float32(2)

    def quotient(x):
        y = min(max(x, -most), most) * quarter
        s = y * y
        a, b = y * (one + s * (a1 + s * (a2 + s * a3))), one + s * (b1 + s * (b2 + s * b3))
        a, b = two * a * b, a * a + b * b
        return two * a * b / (a * a + b * b)

    return quotient
