"""Several numbers at once: what a core's widest registers hold, loaded, multiplied and added up as one value in compiled loops.

Compilers do not find by themselves how to keep the sums of a convolution in the registers of the core. Here it is said: `Lanes` are as many
numbers of single precision as the widest registers there are hold. Where registers are narrower, or numbers longer, several make one
value, so the same text serves both precisions and every chip.

numba keeps compiled code by the age of the file that is compiled from, which is `fast.compiled`: touch that one after a change here.

>>> import numpy as np
>>> from numba import njit
>>> @njit
... def squares_of(x):
...     lanes = load(x, 0)
...     return sum_of(plus_product(all_lanes(x.dtype.type(0)), lanes, lanes))
>>> squares_of(np.full(LANES, 0.5, np.float32))
4.0
"""

# pyright: reportCallIssue=false, reportAttributeAccessIssue=false, reportGeneralTypeIssues=false
# What an intrinsic is called with is not what it is written with, and the types of numba tell pyright little.

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic, models, overload, register_model

LANES = 16
"""Numbers of single precision that fit the widest registers there are."""


class Lanes(types.Type):
    """Several numbers that are computed with at once."""

    def __init__(self, dtype: types.Type) -> None:
        self.dtype = dtype
        super().__init__(name=f"Lanes({dtype})")


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Lanes) -> None:
        super().__init__(manager, kind, ir.VectorType(manager.lookup(kind.dtype).get_value_type(), LANES))


def pointer_to(context: Any, builder: Any, kind: types.Array, numbers: Any, first: Any, lanes: ir.VectorType) -> Any:
    return builder.bitcast(builder.gep(context.make_array(kind)(context, builder, numbers).data, [first]), lanes.as_pointer())


@intrinsic
def load(_: Any, numbers: types.Array, first: types.Integer) -> Any:
    """The numbers of an array from a place on."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        lanes = context.get_value_type(signature.return_type)
        return builder.load(pointer_to(context, builder, numbers, *values, lanes), align=numbers.dtype.bitwidth // 8)

    return Lanes(numbers.dtype)(numbers, types.intp), code


@intrinsic
def store(_: Any, numbers: types.Array, first: types.Integer, lanes: Lanes) -> Any:
    """Write lanes into an array from a place on."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = pointer_to(context, builder, numbers, *values[:2], values[2].type)
        builder.store(values[2], pointer, align=numbers.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(numbers, types.intp, lanes), code


@intrinsic
def all_lanes(_: Any, number: types.Float) -> Any:
    """The same number in all lanes."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        nothing = ir.Constant(context.get_value_type(signature.return_type), ir.Undefined)
        one = builder.insert_element(nothing, values[0], ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(ir.IntType(32), LANES), None))

    return Lanes(number)(number), code


@intrinsic
def plus_product(_: Any, total: Lanes, x: Lanes, y: Lanes) -> Any:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fadd(values[0], builder.fmul(*values[1:], flags=("fast",)), flags=("fast",))

    return total(total, x, y), code


@intrinsic
def sum_of(_: Any, lanes: Lanes) -> Any:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        number = context.get_value_type(lanes.dtype)
        shape = ir.FunctionType(number, [number, values[0].type])
        name = f"llvm.vector.reduce.fadd.v{LANES}f{lanes.dtype.bitwidth}"
        return builder.call(get_or_insert_function(builder.module, shape, name), [ir.Constant(number, 0.0), values[0]], fastmath=("fast",))

    return lanes.dtype(lanes), code


def tanh(x: Any) -> Any:
    """In double precision that of the C library, one number at a time; in single one of products and a division, several at a time.

    That is Lambert's continued fraction at a quarter of x, and twice tanh(2 y) = 2 t / (1 + t^2) of t = tanh(y); 2e-7 off at most.
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
