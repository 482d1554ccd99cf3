"""Eight pixels at once: which of eight directions meet a triangle, and bits to go through what was found.

The compiler does not turn a loop with a test and a store into vectors, so the test is given as one. The arithmetic is that
of one direction after the other, without fused operations: the same bits.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
_BIT, _BYTE, _INT, _LONG = ir.IntType(1), ir.IntType(LANES), ir.IntType(32), ir.IntType(64)
_DOUBLES, _INTS = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(_INT, LANES)
_PAIRS = ir.VectorType(ir.FloatType(), 2 * LANES)


def _same(builder, value):
    """A vector of doubles, all of them value."""
    nothing = ir.Constant(_DOUBLES, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(_INTS, LANES * [0]))


def _bits(builder, flags):
    return builder.zext(builder.bitcast(flags, _BYTE), _LONG)


@intrinsic
def inside_eight(typingctx, directions, i, j, ax, ay, az, bx, by, bz, cx, cy, cz):
    """Bit k: is directions[i, j + k] (x, y, 1) on the inner side, or on, of the planes a, b and c through the eye?

    directions : (h, w, 2) float32 whose last axis is contiguous; holds [i, j + 7];  a, b, c : float64;  not a number = outside
    """
    signature = types.uint64(directions, types.uint64, types.uint64, *(9 * [types.float64]))

    def codegen(context, builder, signature, args):
        kind = signature.args[0]
        array = context.make_array(kind)(context, builder, args[0])
        place = [args[1], args[2], ir.Constant(args[2].type, 0)]
        at = cgutils.get_item_pointer(context, builder, kind, array, place, wraparound=False)
        pairs = builder.load(builder.bitcast(at, _PAIRS.as_pointer()), align=4)
        x, y = (
            builder.fpext(
                builder.shuffle_vector(
                    pairs, ir.Constant(_PAIRS, ir.Undefined), ir.Constant(_INTS, [2 * k + part for k in range(LANES)])
                ),
                _DOUBLES,
            )
            for part in range(2)
        )
        inside = None
        for k in (3, 6, 9):
            px, py, pz = (_same(builder, a) for a in args[k : k + 3])
            side = builder.fadd(builder.fadd(builder.fmul(px, x), builder.fmul(py, y)), pz)
            ok = builder.fcmp_ordered(">=", side, ir.Constant(_DOUBLES, LANES * [0.0]))
            inside = ok if inside is None else builder.and_(inside, ok)
        return _bits(builder, inside)

    return signature, codegen


@intrinsic
def counted_eight(typingctx, numbers, at):
    """Bit k: is numbers[at + k] not negative? numbers : flat int32, contiguous, holds [at + 7]"""
    signature = types.uint64(numbers, types.uint64)

    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        eight = builder.load(builder.bitcast(builder.gep(data, [args[1]]), _INTS.as_pointer()), align=4)
        return _bits(builder, builder.icmp_signed(">=", eight, ir.Constant(_INTS, LANES * [0])))

    return signature, codegen


@intrinsic
def lowest_bit(typingctx, bits):
    """Number of the lowest bit that is set; bits must not be 0."""
    signature = types.uint64(types.uint64)

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(_BIT, 1))

    return signature, codegen
