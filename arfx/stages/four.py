"""Four channels at once: the compiler leaves neighbouring scalar operations apart, so the innermost one is given as vectors.

All arrays are flat and contiguous; nothing here looks whether a place is inside of them.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_VECTOR, _WIDE = ir.VectorType(ir.FloatType(), 4), ir.VectorType(ir.DoubleType(), 4)
_SHORT, _INT = ir.VectorType(ir.IntType(16), 4), ir.VectorType(ir.IntType(32), 4)


def _vector(builder, scalars):
    out = ir.Constant(_VECTOR, ir.Undefined)
    for k, s in enumerate(scalars):
        out = builder.insert_element(out, s, ir.Constant(ir.IntType(32), k))
    return out


def _numbers(context, builder, signature, args, k):
    """Pointer to the numbers of argument k, a contiguous array."""
    return context.make_array(signature.args[k])(context, builder, args[k]).data


def _four(builder, data, index, vector=_VECTOR):
    """Pointer to four numbers from index on."""
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def _cell(builder, data, cell):
    """Pointer to the four floats of a cell."""
    return _four(builder, data, builder.shl(cell, ir.Constant(cell.type, 2)))


@intrinsic
def add_between(typingctx, out, at, line, p, q, t):
    """out[at] += line[p] + (line[q] - line[p]) t, in cells of four floats. out, line : flat float32, contiguous"""
    signature = types.void(out, types.intp, line, types.intp, types.intp, types.float32)

    def codegen(context, builder, signature, args):
        low, high = (
            builder.load(_cell(builder, _numbers(context, builder, signature, args, 2), args[k]), align=4) for k in (3, 4)
        )
        t = _vector(builder, 4 * [args[5]])
        value = builder.fadd(low, builder.fmul(builder.fsub(high, low), t))
        to = _cell(builder, _numbers(context, builder, signature, args, 0), args[1])
        builder.store(builder.fadd(builder.load(to, align=4), value), to, align=4)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def add_two_between(typingctx, out, at, line, p, q, t, step):
    """`add_between` to cells `at` and at + 1, with t and t + step."""
    signature = types.void(out, types.intp, line, types.intp, types.intp, types.float32, types.float32)

    def codegen(context, builder, signature, args):
        low, high = (
            builder.load(_cell(builder, _numbers(context, builder, signature, args, 2), args[k]), align=4) for k in (3, 4)
        )
        slope = builder.fsub(high, low)
        t = _vector(builder, 4 * [args[5]])
        cell = args[1]
        for _ in range(2):
            to = _cell(builder, _numbers(context, builder, signature, args, 0), cell)
            value = builder.fadd(low, builder.fmul(slope, t))
            builder.store(builder.fadd(builder.load(to, align=4), value), to, align=4)
            t, cell = builder.fadd(t, _vector(builder, 4 * [args[6]])), builder.add(cell, ir.Constant(cell.type, 1))
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def mark_ends(typingctx, marks, a, b, c, d, red, green, blue, weight, share, first, last):
    """Ends of one row of a disc, in cells of four floats: with v = (red, green, blue, weight) x share,
    marks[a] += v first, marks[b] += v - v first, marks[c] -= v - v last, marks[d] -= v last.

    marks : flat float32, contiguous
    """
    signature = types.void(marks, *(4 * [types.intp]), *(7 * [types.float32]))

    def codegen(context, builder, signature, args):
        data = _numbers(context, builder, signature, args, 0)
        light = builder.fmul(_vector(builder, args[5:9]), _vector(builder, 4 * [args[9]]))
        begin = builder.fmul(light, _vector(builder, 4 * [args[10]]))
        end = builder.fmul(light, _vector(builder, 4 * [args[11]]))
        for cell, add, value in (
            (args[1], True, begin),
            (args[2], True, builder.fsub(light, begin)),
            (args[3], False, builder.fsub(light, end)),
            (args[4], False, end),
        ):
            place = _cell(builder, data, cell)
            before = builder.load(place, align=4)
            after = builder.fadd(before, value) if add else builder.fsub(before, value)
            builder.store(after, place, align=4)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def put_colour(typingctx, out, at, light, x):
    """out[at .. at + 2] = red, green, blue / weight of light's cell x; out[at + 3] is overwritten too.

    out, light : flat float32, contiguous
    """
    signature = types.void(out, types.intp, light, types.intp)

    def codegen(context, builder, signature, args):
        value = builder.load(_cell(builder, _numbers(context, builder, signature, args, 2), args[3]), align=4)
        weight = builder.extract_element(value, ir.Constant(ir.IntType(32), 3))
        inverse = builder.fdiv(ir.Constant(ir.FloatType(), 1.0), weight)
        value = builder.fmul(value, _vector(builder, 4 * [inverse]))
        data = _numbers(context, builder, signature, args, 0)
        to = _four(builder, data, args[1])
        builder.store(value, to, align=4)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def add_pixel(typingctx, sums, at, line, p):
    """sums[at : at + 4] += line[p], line[p + 1], line[p + 2], 1. sums : float64;  line : float32, has a number at p + 3"""
    signature = types.void(sums, types.uint64, line, types.uint64)

    def codegen(context, builder, signature, args):
        to = _four(builder, _numbers(context, builder, signature, args, 0), args[1], _WIDE)
        colour = builder.load(_four(builder, _numbers(context, builder, signature, args, 2), args[3]), align=4)
        colour = builder.insert_element(colour, ir.Constant(ir.FloatType(), 1.0), ir.Constant(ir.IntType(32), 3))
        builder.store(builder.fadd(builder.load(to, align=8), builder.fpext(colour, _WIDE)), to, align=8)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def copy_four(typingctx, table, at, out, to):
    """out[to : to + 4] = table[at : at + 4], float32."""
    signature = types.void(table, types.uint64, out, types.uint64)

    def codegen(context, builder, signature, args):
        source = _four(builder, _numbers(context, builder, signature, args, 0), args[1])
        target = _four(builder, _numbers(context, builder, signature, args, 2), args[3])
        builder.store(builder.load(source, align=4), target, align=4)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def mix_four(typingctx, table, at, other, share, out, to):
    """out[to : to + 4] = table[at : at + 4] + share (other[:4] - table[at : at + 4]), float32."""
    signature = types.void(table, types.uint64, other, types.float32, out, types.uint64)

    def codegen(context, builder, signature, args):
        first = builder.load(_four(builder, _numbers(context, builder, signature, args, 0), args[1]), align=4)
        start = ir.Constant(ir.IntType(32), 0)
        second = builder.load(_four(builder, _numbers(context, builder, signature, args, 2), start), align=4)
        share = _vector(builder, 4 * [args[3]])
        mixed = builder.fadd(first, builder.fmul(share, builder.fsub(second, first)))
        builder.store(mixed, _four(builder, _numbers(context, builder, signature, args, 4), args[5]), align=4)
        return context.get_dummy_value()

    return signature, codegen


def _weighted(context, builder, signature, args, terms, load):
    """Tuple of four: sum over k of weight x what `load` makes of row args[k] of the array args[0]; weights follow the rows."""
    data, total = _numbers(context, builder, signature, args, 0), None
    for k in range(1, terms + 1):
        value = builder.fmul(load(builder, data, args[k]), _vector(builder, 4 * [args[k + terms]]), flags=("fast",))
        total = value if total is None else builder.fadd(total, value, flags=("fast",))
    parts = [builder.extract_element(total, ir.Constant(ir.IntType(32), k)) for k in range(4)]
    return context.make_tuple(builder, signature.return_type, parts)


@intrinsic
def mean_of_rows(typingctx, rows, i, j, k, a, b, c):
    """a rows[i] + b rows[j] + c rows[k], a tuple. rows : (n, 4) float32"""
    signature = types.UniTuple(types.float32, 4)(rows, *(3 * [types.uint64]), *(3 * [types.float32]))

    def codegen(context, builder, signature, args):
        return _weighted(context, builder, signature, args, 3, lambda b, data, row: b.load(_cell(b, data, row), align=4))

    return signature, codegen


@intrinsic
def mean_of_texels(typingctx, texels, i, j, k, m, a, b, c, d):
    """a texels[i] + b texels[j] + c texels[k] + d texels[m], a tuple. texels : (n, 4) uint16"""
    signature = types.UniTuple(types.float32, 4)(texels, *(4 * [types.uint64]), *(4 * [types.float32]))

    def codegen(context, builder, signature, args):
        def load(b, data, row):
            place = _four(b, data, b.shl(row, ir.Constant(row.type, 2)), _SHORT)
            return b.sitofp(b.zext(b.load(place, align=2), _INT), _VECTOR)

        return _weighted(context, builder, signature, args, 4, load)

    return signature, codegen
