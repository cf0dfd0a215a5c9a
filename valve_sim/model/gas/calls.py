"""How compiled code calls a force term by its address: the one place that talks to LLVM."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def call_term(
    typingctx: Any, address: Any, x: Any, v: Any, u: Any, t: Any, numbers: Any
) -> tuple[Any, Any]:  # pragma: no cover - runs in the compiler
    """Call a compiled term f(x, v, u, t, numbers) by its address; `numbers` is a contiguous array."""
    signature = types.float64(types.int64, types.float64, types.float64, types.float64, types.float64, numbers)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[5])(context, builder, arguments[5])
        double = ir.DoubleType()
        kind = ir.FunctionType(double, [double] * 4 + [array.data.type])
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        return builder.call(function, [*arguments[1:5], array.data], attrs=("nounwind", "readonly"))

    return signature, generate
