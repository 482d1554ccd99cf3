"""Four numbers at a time, for kernels: what the compiler does not find by itself in loops whose places are looked up.

All arrays are contiguous and of one dimension; nothing here looks whether a place is inside of them.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_I32 = ir.IntType(32)


def _place(context: Any, builder: Any, typ: Any, array: Any, index: Any, kind: Any) -> Any:
    """Pointer to four numbers from index on."""
    data = context.make_array(typ)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), ir.VectorType(kind, 4).as_pointer())


@intrinsic
def add_pixel(typing: Any, sums: Any, at: Any, line: Any, p: Any) -> Any:
    """sums[at : at + 4] += line[p], line[p + 1], line[p + 2], 1. sums : float64;  line : float32, has a number at p + 3"""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        to = _place(context, builder, signature.args[0], args[0], args[1], ir.DoubleType())
        colour = builder.load(_place(context, builder, signature.args[2], args[2], args[3], ir.FloatType()), align=4)
        colour = builder.insert_element(colour, ir.Constant(ir.FloatType(), 1.0), _I32(3))
        wide = builder.fpext(colour, ir.VectorType(ir.DoubleType(), 4))
        builder.store(builder.fadd(builder.load(to, align=8), wide), to, align=8)
        return context.get_dummy_value()

    return types.void(sums, types.uint64, line, types.uint64), make


@intrinsic
def copy_four(typing: Any, table: Any, at: Any, out: Any, to: Any) -> Any:
    """out[to : to + 4] = table[at : at + 4], float32."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source = _place(context, builder, signature.args[0], args[0], args[1], ir.FloatType())
        target = _place(context, builder, signature.args[2], args[2], args[3], ir.FloatType())
        builder.store(builder.load(source, align=4), target, align=4)
        return context.get_dummy_value()

    return types.void(table, types.uint64, out, types.uint64), make


@intrinsic
def mix_four(typing: Any, table: Any, at: Any, other: Any, share: Any, out: Any, to: Any) -> Any:
    """out[to : to + 4] = table[at : at + 4] + share (other[:4] - table[at : at + 4]), float32."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        four = ir.VectorType(ir.FloatType(), 4)
        none = _I32(0)
        first = builder.load(_place(context, builder, signature.args[0], args[0], args[1], ir.FloatType()), align=4)
        second = builder.load(_place(context, builder, signature.args[2], args[2], _I32(0), ir.FloatType()), align=4)
        one = builder.insert_element(ir.Constant(four, ir.Undefined), args[3], none)
        shares = builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(_I32, 4), [0, 0, 0, 0]))
        mixed = builder.fadd(first, builder.fmul(shares, builder.fsub(second, first)))
        builder.store(mixed, _place(context, builder, signature.args[4], args[4], args[5], ir.FloatType()), align=4)
        return context.get_dummy_value()

    return types.void(table, types.uint64, other, types.float32, out, types.uint64), make
