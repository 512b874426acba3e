"""What a vector is to the compiler: its types, what numbers beside it become, and its operators. See ``vectors.py``."""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

from common.processor import features
from services.infra_lidar.jit import ASKED_FIRST

PROCESSOR = features()
LANES = 16 if PROCESSOR.get("avx512f") else 8  # of 32 bits; processors with shorter vectors split them

WORD, BIT = ir.IntType(32), ir.IntType(1)
Emit = Callable[..., Any]  # (builder, values ...) -> value
_SCALARS: dict[Any, Any] = {types.float32: ir.FloatType(), types.int32: WORD, types.boolean: BIT}


class Vector(types.Type):
    """``LANES`` of float32, int32 or flags."""

    def __init__(self, scalar: Any) -> None:
        self.scalar = scalar
        super().__init__(name=f"vector({scalar} x {LANES})")

    @property
    def llvm(self) -> Any:
        """As LLVM has it."""
        return ir.VectorType(_SCALARS[self.scalar], LANES)


FLOATS, INTS, FLAGS = Vector(types.float32), Vector(types.int32), Vector(types.boolean)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Vector) -> None:
        super().__init__(manager, kind, kind.llvm)


def lane_list(lanes: list[int]) -> Any:
    """Lanes for a shuffle."""
    return ir.Constant(ir.VectorType(WORD, len(lanes)), lanes)


@lower_cast(types.Float, FLOATS)
@lower_cast(types.Integer, FLOATS)
@lower_cast(types.Integer, INTS)
def spread_number(context: Any, builder: Any, given: Any, kind: Any, value: Any) -> Any:
    """A number beside a vector stands for as many of it."""
    number, none = context.cast(builder, value, given, kind.scalar), ir.Constant(kind.llvm, ir.Undefined)
    one = builder.insert_element(none, number, ir.Constant(WORD, 0))
    return builder.shuffle_vector(one, none, lane_list([0] * LANES))


def kind_of(arguments: tuple[Any, ...]) -> Vector | None:
    """The kind of vector that the arguments are, numbers counted as such; None where they do not go together."""
    kinds = {a for a in arguments if isinstance(a, Vector)}
    known = all(isinstance(a, Vector | types.Integer | types.Float) for a in arguments)
    kind = kinds.pop() if len(kinds) == 1 and known else None
    floats_in_ints = kind == INTS and any(isinstance(a, types.Float) for a in arguments)
    return None if floats_in_ints else kind


def as_intrinsic(definition: Callable[..., Any], named: Callable[..., Any], **options: Any) -> Any:
    """What numba calls by ``definition``, with the name, the text and the arguments of ``named``."""
    own, context = inspect.signature(named), inspect.Parameter("typing_context", inspect.Parameter.POSITIONAL_ONLY)
    definition.__name__, definition.__doc__ = named.__name__, named.__doc__
    definition.__signature__ = own.replace(parameters=[context, *own.parameters.values()])  # type: ignore[attr-defined]
    return intrinsic(**options)(definition) if options else intrinsic(definition)


def _operator(symbols: tuple[Any, ...], emit: dict[Vector, Emit], result: Vector | None = None) -> None:
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            kind = kind_of(args)
            return signature(result or kind, *[kind] * len(args)) if kind in emit else None

    for symbol in symbols:
        infer_global(symbol)(type(f"Vector_{symbol.__name__}", (_Template,), ASKED_FIRST))
        arguments = 1 if symbol is operator.invert else 2
        for kind, build in emit.items():

            @lower_builtin(symbol, *[kind] * arguments)
            def _lower(context: Any, builder: Any, sig: Any, args: Any, build: Emit = build) -> Any:
                return build(builder, *args)


_B = ir.IRBuilder
_operator((operator.add, operator.iadd), {FLOATS: _B.fadd, INTS: _B.add})
_operator((operator.sub, operator.isub), {FLOATS: _B.fsub, INTS: _B.sub})
_operator((operator.mul, operator.imul), {FLOATS: _B.fmul, INTS: _B.mul})
_operator((operator.truediv,), {FLOATS: _B.fdiv})
_operator((operator.and_, operator.iand), {INTS: _B.and_, FLAGS: _B.and_})
_operator((operator.or_, operator.ior), {INTS: _B.or_, FLAGS: _B.or_})
_operator((operator.xor,), {INTS: _B.xor, FLAGS: _B.xor})
_operator((operator.invert,), {INTS: _B.not_, FLAGS: _B.not_})
_operator((operator.lshift,), {INTS: _B.shl})
_operator((operator.rshift,), {INTS: _B.ashr})


def compare(sign: str) -> dict[Vector, Emit]:
    """Flags of a comparison; false where one of two floats is no number."""
    return {
        FLOATS: lambda builder, a, b: builder.fcmp_ordered(sign, a, b),
        INTS: lambda builder, a, b: builder.icmp_signed(sign, a, b),
    }


for _symbol, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
    (operator.ne, "!="),
):  # fmt: skip
    _operator((_symbol,), compare(_sign), FLAGS)
